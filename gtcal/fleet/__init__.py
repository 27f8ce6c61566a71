"""Many recordings of many rigs over months: jobs that run on all cores or a cluster, the store of their results, each
rig's history with its control charts, the site that shows it, and the station beside the capture volume.

One thing flows through all of it, one way: jobs (``jobs``) are done by workers (``run_job``, ``workers``), what comes
back is put into the store (``store``, ``index``), and all else reads the store."""
