"""Files by content: the files that a client sends, and the folder in which a worker keeps them."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from etendue.core import ClusterError

#: Size of the pieces in which files are sent.
PIECE = 16 << 20
#: Files that no run has used for this time are removed.
_KEPT_SECONDS = 7 * 24 * 3600.0
#: Names of files, of parts of files that are being sent, and of folders with links, in the folder of a worker.
_OWN = re.compile(r"[0-9a-f]{32}(\.\d+\.part)?|[0-9a-f]{8}-[a-z0-9_]{8}")
#: Environment variable with the folder of a worker.
FOLDER_VARIABLE = "ETENDUE_CONTENT"


@dataclass(frozen=True)
class ContentFile:
    """A file by content. ``origin``: where the client has it; a worker that finds the same content there needs no
    copy."""

    digest: str
    size: int
    origin: str = ""


def digest_of(content: bytes | Path) -> str:
    """BLAKE2b of 16 bytes, hexadecimal."""
    if isinstance(content, bytes):
        return hashlib.blake2b(content, digest_size=16).hexdigest()
    status = content.stat()
    return _digest_of_file(str(content), status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=4096)
def _digest_of_file(path: str, size: int, changed: int) -> str:
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as file:
        while piece := file.read(PIECE):
            digest.update(piece)
    return digest.hexdigest()


@dataclass
class Offered:
    """Files and bytes that a client may send, by digest."""

    contents: dict[str, bytes | Path] = field(default_factory=dict)

    def add(self, content: bytes | Path) -> ContentFile:
        """Offer a file or bytes."""
        digest = digest_of(content)
        self.contents[digest] = content
        if isinstance(content, bytes):
            return ContentFile(digest, len(content))
        return ContentFile(digest, content.stat().st_size, str(content.absolute()))

    def size(self, digest: str) -> int:
        """Bytes of a file."""
        content = self.contents[digest]
        return len(content) if isinstance(content, bytes) else content.stat().st_size

    def pieces(self, digest: str) -> Iterator[tuple[int, bytes, bool]]:
        """Offset and bytes of each piece, and whether it is the last. Raises :class:`ClusterError` for a file that is
        no longer there."""
        content = self.contents[digest]
        if isinstance(content, bytes):
            yield 0, content, True
            return
        try:
            opened = content.open("rb")
        except OSError as error:
            raise ClusterError(
                f"'{content}' cannot be sent ({error.strerror}): put it back, and start again"
            ) from error
        with opened as file:
            offset, piece = 0, file.read(PIECE)
            while True:
                following = file.read(PIECE)
                yield offset, piece, not following
                if not following:
                    return
                offset, piece = offset + len(piece), following


class Store:
    """The folder of a worker; workers of one user on one machine share it."""

    def __init__(self, folder: Path | None = None) -> None:
        given = os.environ.get(FOLDER_VARIABLE)
        self.folder = folder or Path(given or Path(tempfile.gettempdir()) / f"etendue-content-{os.getuid()}")
        with self._told():
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # In a folder that all may write to, a link could lead anywhere.
            status = self.folder.stat() if folder or given else self.folder.lstat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            raise ClusterError(f"others may write to the folder '{self.folder}'; name one by {FOLDER_VARIABLE}")

    def find(self, entry: ContentFile) -> Path | None:
        """A file of this content, ``None`` if it must be sent."""
        path = self.folder / entry.digest
        if path.is_file():
            os.utime(path)
            return path
        origin = Path(entry.origin)
        try:
            if entry.origin and origin.stat().st_size == entry.size and digest_of(origin) == entry.digest:
                return origin
        except OSError:
            pass
        return None

    def receive(self, digest: str, offset: int, piece: bytes, is_last: bool) -> None:
        """Write a piece. Raises :class:`ClusterError` if the disk is full, or if the file does not match its digest."""
        part = self.folder / f"{digest}.{os.getpid()}.part"
        with self._told():
            try:
                with part.open("r+b" if offset else "wb") as file:
                    file.seek(offset)
                    file.write(piece)
            except OSError:
                part.unlink(missing_ok=True)  # free the room of the incomplete file
                raise
            if not is_last:
                return
            if digest_of(part) != digest:
                part.unlink()
                raise ClusterError("a file changed while it was sent; start again")
            os.replace(part, self.folder / digest)

    def tree(self, name: str, places: dict[str, Path]) -> Path:
        """A folder with links to files at their places. Raises :class:`ClusterError` for a place outside of it."""
        with self._told():
            folder = Path(tempfile.mkdtemp(prefix=f"{name[:8]}-", dir=self.folder))
            for place, path in places.items():
                link = folder / place
                if ".." in Path(place).parts or Path(place).is_absolute():
                    raise ClusterError(f"'{place}' is no place in the folder of a scene")
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(path)
        return folder

    def tidy(self) -> None:
        """Remove files of this class that have not been used for long, and remains of workers that were killed."""
        for path in self.folder.iterdir():
            try:
                if not _OWN.fullmatch(path.name) or time.time() - path.lstat().st_mtime < _KEPT_SECONDS:
                    continue
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()
            except OSError:
                continue

    def _told(self) -> _Told:
        return _Told(self.folder)


class _Told:
    """Converts errors of the disk to one line."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            reason = error.strerror or str(error)
            raise ClusterError(
                f"'{self._folder}' cannot hold the scene ({reason}); free some room, or name another folder by "
                f"{FOLDER_VARIABLE}"
            ) from error
