"""What a folder, a recording or a result holds, at a glance; and drafts of manifests."""
