"""NumPy's npz from anywhere: shapes and types are looked at before anything is unpacked."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from gtcal.errors import GtcalError
from gtcal.files import check_regular

_KINDS = "biufU"  # of numbers and text; neither objects, which are code, nor records


def load_arrays(path: Path, most_bytes: int) -> dict[str, npt.NDArray[Any]]:
    """The arrays of an npz, by name, which unpacked take at most so many bytes together.

    Raises GtcalError where it is none, is damaged, holds something else than numbers and text, or more."""
    check_regular(path, most_bytes)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > most_bytes:
                raise GtcalError(f"{path}: unpacks to more than {most_bytes // 2**20} MiB, too much for such a file")
            return {member.filename.removesuffix(".npy"): _array(path, archive, member) for member in members}
    except GtcalError:
        raise
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror or 'it is no npz, or damaged'}") from error
    except Exception as error:  # whatever zipfile, zlib and NumPy raise for damaged bytes
        raise GtcalError(f"{path}: is no npz, or damaged: {' '.join(str(error).split()) or 'cut off'}") from error


def _array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> npt.NDArray[Any]:
    with archive.open(member) as file:
        shape, fortran, dtype = _header(file)
        size = math.prod(shape) * dtype.itemsize
        if dtype.kind not in _KINDS or len(shape) > 3 or any(side < 0 for side in shape) or size > member.file_size:
            raise GtcalError(
                f"{path}: {member.filename}: states {dtype} in a shape of {shape}, which is none of numbers or text "
                "that its bytes could hold"
            )
        content = file.read(size)
    array = np.frombuffer(content, dtype, count=math.prod(shape))
    return array.reshape(shape, order="F" if fortran else "C").copy()


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return tuple(shape), bool(fortran), dtype
