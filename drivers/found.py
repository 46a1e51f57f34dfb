"""Settings as found: what a driver has changed on its device, so that the device is left as it was.

Before a driver writes a setting it notes the value that it found and the one that it writes. At the end of its session it
writes the found values back, of those settings that still have a value of its own: another program may have changed the rest.

The note outlives the program. After a crash, or where the device did not respond at the end, the next connection takes it up:
a setting that still has a written value was found as the note has it; any other value was set since, and is found now.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol


class NoteStore(Protocol):
    """Where the note about one device outlives the program."""

    def read(self) -> str:
        """The note; empty if there is none."""

    def write(self, text: str) -> None:
        """Replace the note; an empty one is removed."""


@dataclass(frozen=True)
class Change:
    """A setting as it was found, and the values that the driver has written since."""

    found: str
    written: tuple[str, ...]


class FoundSettings:
    """The changes of one device, by the names of its settings; values are texts.

    `asks`: the driver may ask the device for settings only to note them. Without it the driver notes what it reads anyway.
    """

    def __init__(self, store: NoteStore | None = None, *, asks: bool = True) -> None:
        self._store = store
        self._identity = ""
        self._changes: dict[str, Change] = {}
        self.asks = asks

    @property
    def changes(self) -> Mapping[str, Change]:
        """The changes, in the order in which they were made."""
        return self._changes

    def take_up(self, identity: str) -> None:
        """Begin a session with a device: take up the note of an earlier one that has not ended well."""
        if identity != self._identity:
            self._identity, self._changes = identity, {}
        if self._store is not None and (changes := _decode(self._store.read(), identity)):
            self._changes = changes

    def note(self, settings: Mapping[str, tuple[str, str]]) -> None:
        """Note settings before they are written: the value that each has now, and the one that it gets."""
        changes = dict(self._changes)
        for name, (present, wanted) in settings.items():
            earlier = changes.get(name, Change(present, ()))
            found, written = (earlier.found, earlier.written) if present in earlier.written else (present, ())
            if wanted not in (found, *written):
                written = (*written, wanted)
            if written:
                changes[name] = Change(found, written)
            else:
                changes.pop(name, None)
        self._keep(changes)

    def value_to_restore(self, name: str, present: str) -> str | None:
        """The value that a setting was found with; None if it has that one, or one that another program has set."""
        change = self._changes.get(name)
        return change.found if change is not None and present in change.written and present != change.found else None

    def clear(self) -> None:
        """The device is as it was found."""
        self._keep({})

    def _keep(self, changes: dict[str, Change]) -> None:
        if changes == self._changes:
            return
        self._changes = changes
        if self._store is not None:
            note = {"identity": self._identity, "settings": {name: asdict(each) for name, each in changes.items()}}
            self._store.write(json.dumps(note) if changes else "")


def _decode(text: str, identity: str) -> dict[str, Change]:
    """The changes of a note about a device of this identity; none for any other text."""
    try:
        note = json.loads(text)
        changes = {name: Change(each["found"], tuple(each["written"])) for name, each in note["settings"].items()}
    except (ValueError, LookupError, TypeError, AttributeError):
        return {}
    texts: list[Any] = [text for each in changes.values() for text in (each.found, *each.written)]
    sound = all(isinstance(text, str) and text.isascii() and text.isprintable() for text in texts)
    return changes if sound and note.get("identity") == identity else {}
