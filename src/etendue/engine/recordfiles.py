"""Records of a checkpoint: files in the folder ``NAME.records`` beside the checkpoint ``NAME``.

A file is written once, and is valid as soon as the checkpoint names it. Each save writes the rows that are in no file
yet, together with the rows of files that are not larger than what it writes. So n saves leave log n files, as in a
merge sort, and the cost of a save is proportional to the new rows. The files are NumPy arrays, which a resumed run maps
into memory. Files that the checkpoint does not name are left over from an interrupted save or an earlier run; the next
save removes them.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import CheckpointError, OutputError, Record, RecordFile
from etendue.film import check_writable, replacing

#: Bytes per step of a checksum.
_BLOCK = 1 << 24
#: Suffixes of our files, including unfinished ones.
_OURS = re.compile(r"-[0-9a-f]{12}\.npy(\.[0-9a-f]{16}\.npy)?$")


def folder_of(checkpoint: str | os.PathLike[str]) -> Path:
    """The folder of the records of a checkpoint."""
    path = Path(checkpoint)
    return path.with_name(path.name + ".records")


def check_records(checkpoint: str | os.PathLike[str]) -> None:
    """Raise :class:`OutputError` if the records of a checkpoint could not be written now; leaves nothing behind."""
    folder = folder_of(checkpoint)
    if folder.is_dir():
        check_writable(folder / "rows.npy")
    elif folder.exists() or folder.is_symlink():
        raise OutputError(f"cannot write '{folder}': it is not a folder; remove it, or choose another checkpoint")


def write_records(records: Mapping[str, Record], checkpoint: str | os.PathLike[str]) -> dict[str, Any]:
    """Write the rows that are not in files yet, and map these files into the records. Returns their description for
    the header of the checkpoint. Raises :class:`OutputError`; existing files remain."""
    if not records:
        return {}
    check_writable(checkpoint)
    folder = folder_of(checkpoint)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write '{folder}': {error.strerror or error}; choose another checkpoint") from None
    return {name: _write(name, record, folder) for name, record in records.items()}


def _write(name: str, record: Record, folder: Path) -> list[dict[str, Any]]:
    here = [file for file in record.files if _is_in(folder, file)]
    kept = {key for file in here for key, _ in file.passes}
    new = [key for key in record.passes if key not in kept]
    if new:
        count = sum(len(record[key]) for key in new)
        while here and len(here[-1]) <= count:
            joined = here.pop()
            count += len(joined)
            new += [key for key, _ in joined.passes]
        new.sort()
        path, parts, checksum = (
            folder.absolute() / f"{name}-{secrets.token_hex(6)}.npy",
            [record[key] for key in new],
            0,
        )
        with replacing(path) as part, open(part, "wb") as file:
            shape = (count, *parts[0].shape[1:])
            layout = {"descr": parts[0].dtype.str, "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_2_0(file, layout)
            for rows in parts:
                data = np.ascontiguousarray(rows)
                checksum = _checksum(data, checksum)
                data.tofile(file)
        passes = tuple((key, len(rows)) for key, rows in zip(new, parts, strict=True))
        record.keep(here, RecordFile(str(path), checksum, passes), _mapped(path))
        here = record.files
    return [
        {"file": Path(file.path).name, "checksum": file.checksum, "passes": [[*key, n] for key, n in file.passes]}
        for file in here
    ]


def _is_in(folder: Path, file: RecordFile) -> bool:
    """Whether a file still exists in the folder: another run of the same name may have removed it."""
    path = Path(file.path)
    return path.parent.resolve() == folder.resolve() and path.is_file()


def read_records(header: Mapping[str, Any], checkpoint: str | os.PathLike[str]) -> dict[str, Record]:
    """Inverse of :func:`write_records`; the files are mapped, not read. Raises :class:`CheckpointError` if a file is
    missing or damaged."""
    records = {}
    for name, files in header.items():
        record = records[name] = Record()
        for known in files:
            path = folder_of(checkpoint).absolute() / known["file"]
            passes = tuple(((int(replica), int(iteration)), int(n)) for replica, iteration, n in known["passes"])
            try:
                rows = _mapped(path)
            except FileNotFoundError:
                raise CheckpointError(
                    f"{path} is missing, which checkpoint {checkpoint} needs: move the checkpoint and its folder "
                    f"{folder_of(checkpoint).name} together"
                ) from None
            except OSError as error:
                raise CheckpointError(
                    f"cannot read {path}, a part of checkpoint {checkpoint}: {error.strerror or error}"
                ) from error
            except (ValueError, EOFError) as error:
                raise CheckpointError(f"{path}, a part of checkpoint {checkpoint}, is damaged ({error})") from error
            if len(rows) != sum(n for _, n in passes) or _checksum(rows) != known["checksum"]:
                raise CheckpointError(f"{path}, a part of checkpoint {checkpoint}, is damaged; cast the lines anew")
            record.keep(record.files, RecordFile(str(path), known["checksum"], passes), rows)
    return records


def remove_others(header: Mapping[str, Any], checkpoint: str | os.PathLike[str]) -> None:
    """Remove files of records that the checkpoint does not name, and the folder if it is then empty."""
    folder = folder_of(checkpoint)
    named = {known["file"] for files in header.values() for known in files}
    with contextlib.suppress(OSError):
        for path in folder.glob("*.npy"):
            if _OURS.search(path.name) and path.name not in named:
                path.unlink()
        if not named and folder.is_dir():
            folder.rmdir()


def _mapped(path: Path) -> NDArray[Any]:
    return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))


def _checksum(rows: NDArray[Any], start: int = 0) -> int:
    data = np.ascontiguousarray(rows).reshape(-1).view(np.uint8)
    for begin in range(0, len(data), _BLOCK):
        start = zlib.crc32(data[begin : begin + _BLOCK].data, start)
    return start
