"""Files and folders of the user of this program alone: what is found there was put there by this user's programs."""

import errno
import os
import stat
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from platformdirs import PlatformDirs


def state_folder() -> Path:
    """The folder of this user's programs for what outlives them. It is not looked at."""
    return _folders().user_state_path


def cache_folder() -> Path:
    """The folder of this user's programs for what they can make again. It is not looked at."""
    return _folders().user_cache_path


def _folders() -> "PlatformDirs":
    from platformdirs import PlatformDirs  # 20 ms, which most commands do without

    return PlatformDirs("goniotwin", appauthor=False)


def make_own_folder(folder: Path) -> None:
    """Make a folder with its parents, for this user alone, or check one that exists.

    Raises OSError with the folder and the reason: it is a link, it or a folder above it belongs to another user, or others
    may write to it. A link above it is followed if it belongs to this user or to the system. On Windows, where a user's
    folders are closed to others, nothing is checked.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not hasattr(os, "geteuid"):
            return
        status = folder.lstat()
        above = {*folder.absolute().parents, *folder.resolve().parents}
        owners = {each.lstat().st_uid for each in above}
    except (FileExistsError, NotADirectoryError):
        what = "is a link" if folder.is_symlink() else "is not a folder"
        raise OSError(f"{folder}: {what}; choose another") from None
    except OSError as error:
        raise OSError(f"{folder}: cannot be used: {error.strerror}; choose another folder") from None
    if stat.S_ISLNK(status.st_mode):
        raise OSError(f"{folder}: is a link; choose another")
    if status.st_uid != os.geteuid() or owners - {0, os.geteuid()}:
        raise OSError(f"{folder}: it or a folder above it belongs to another user; choose another folder")
    if status.st_mode & stat.S_IWOTH:
        raise OSError(f"{folder}: every user may write to it; choose another folder, or change its permissions")


def read_regular(path: Path, longest: int) -> bytes:
    """At most so many bytes of a file; no link is followed, and what is no file (a named pipe) is not waited for.

    Raises OSError.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        return os.read(handle, longest)
    finally:
        os.close(handle)


def replace_text(path: Path, text: str, mode: int = 0o600) -> None:
    """Put a text at a path by renaming: another program reads the old text or the new one, and neither is changed by a failure.

    Raises OSError; no other file is left then.
    """
    handle, spare = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        if mode != 0o600:  # which it has
            Path(spare).chmod(mode)
        Path(spare).replace(path)
    except OSError:
        Path(spare).unlink()
        raise
