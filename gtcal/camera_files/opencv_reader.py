"""OpenCV's reader of its FileStorage, as ``gtcal.own_process`` runs it."""

from __future__ import annotations

from typing import Any

import cv2


class Reader:
    """Of any file."""

    def document(self, path: str) -> Any:
        """Its maps, lists, texts, numbers and matrices; None where it is no map."""
        try:
            storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)  # its nodes live as long as it does
            root = storage.root()
            return _plain(root) if root.isMap() else None
        except (cv2.error, SystemError) as error:
            raise ValueError(getattr(error.__cause__ or error, "err", "") or "damaged") from None


def _plain(node: cv2.FileNode) -> Any:
    if node.isMap():
        keys = node.keys()
        return node.mat() if {"rows", "cols", "dt"} <= set(keys) else {key: _plain(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_plain(node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return (int(node.real()) if node.isInt() else node.real()) if node.isInt() or node.isReal() else None
