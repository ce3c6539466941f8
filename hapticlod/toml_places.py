"""Where every key and array element of a TOML text stands: {path: (line, column)}, both counted from 1.

`tomllib` gives values without places. This walks a text that `tomllib` has already accepted, so it need not check
the grammar, only follow it. A path mixes table keys (str) and array positions (int), as pydantic's error paths do.
"""

import re

Path = tuple[str | int, ...]
Place = tuple[int, int]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}#\r\n]+")
_BLANK = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)+")


def key_places(text: str) -> dict[Path, Place]:
    """Places of all keys, tables and array elements of a valid TOML text."""
    return _Walk(text).places


class _Walk:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.places: dict[Path, Place] = {(): (1, 1)}
        self.newest: dict[Path, int] = {}  # array of tables -> index of its newest table
        table: Path = ()
        self._blank()
        while self.at < len(text):
            if text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._blank()

    def _mark(self, path: Path, at: int) -> None:
        line_start = self.text.rfind("\n", 0, at) + 1
        self.places.setdefault(path, (self.text.count("\n", 0, at) + 1, at - line_start + 1))

    def _blank(self) -> None:
        if found := _BLANK.match(self.text, self.at):
            self.at = found.end()

    def _string(self) -> str:
        """Skips a string; returns its raw content (escapes are left alone: no key of ours has any)."""
        quote = self.text[self.at]
        fence = quote * 3 if self.text.startswith(quote * 3, self.at) else quote
        start = self.at = self.at + len(fence)
        while not self.text.startswith(fence, self.at):
            self.at += 2 if quote == '"' and self.text[self.at] == "\\" else 1
        content = self.text[start : self.at]
        self.at += len(fence)
        while len(fence) == 3 and self.text.startswith(quote, self.at):  # a quote may touch the closing fence
            self.at += 1
        return content

    def _key(self) -> tuple[str, ...]:
        parts: list[str] = []
        while True:
            self._blank()
            if self.text[self.at] in "\"'":
                parts.append(self._string())
            else:
                found = _BARE.match(self.text, self.at)
                assert found is not None, "tomllib accepted the text"
                parts.append(found.group())
                self.at = found.end()
            self._blank()
            if self.text[self.at] != ".":
                return tuple(parts)
            self.at += 1

    def _resolved(self, table: Path, keys: tuple[str, ...]) -> Path:
        """`keys` below `table`, with the newest index added after every array of tables on the way."""
        path = table
        for key in keys:
            path += (key,)
            if path in self.newest:
                path += (self.newest[path],)
        return path

    def _header(self) -> Path:
        start = self.at
        double = self.text.startswith("[[", self.at)
        self.at += 2 if double else 1
        keys = self._key()
        self.at += 2 if double else 1
        if not double:
            path = self._resolved((), keys)
        else:
            array = self._resolved((), keys[:-1]) + keys[-1:]
            self._mark(array, start)
            self.newest[array] = self.newest.get(array, -1) + 1
            path = (*array, self.newest[array])
        self._mark(path, start)
        return path

    def _pair(self, table: Path) -> None:
        start = self.at
        keys = self._key()
        for depth in range(1, len(keys) + 1):
            self._mark(table + keys[:depth], start)
        self.at += 1  # "="
        self._value(table + keys)

    def _value(self, path: Path) -> None:
        self._blank()
        first = self.text[self.at]
        if first in "\"'":
            self._string()
        elif first == "[":
            self._items("]", path)
        elif first == "{":
            self._items("}", path)
        else:
            found = _SCALAR.match(self.text, self.at)
            assert found is not None, "tomllib accepted the text"
            self.at = found.end()

    def _items(self, close: str, path: Path) -> None:
        """The inside of an array or of an inline table."""
        self.at += 1
        index = 0
        self._blank()
        while self.text[self.at] != close:
            if close == "]":
                self._mark((*path, index), self.at)
                self._value((*path, index))
                index += 1
            else:
                self._pair(path)
            self._blank()
            if self.text[self.at] == ",":
                self.at += 1
                self._blank()
        self.at += 1
