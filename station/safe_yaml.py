"""YAML from anybody: plain data of a bounded size, or one line that says why not.

A document is looked at as a stream of events before anything large is built of it, so neither a page of aliases that
stands for gigabytes nor ten thousand brackets cost more than reading them. What has neither aliases nor tags, as nearly
every document, is built on the way, in half the time that YAML's own constructor takes after that.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import yaml

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# What the constructor of tagged and of odd values raises beside YAMLError: "!!bool maybe", a month 13, 5000 digits.
_ODD = (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError, RecursionError)
_PLAIN_TAG = "tag:yaml.org,2002:"
_NUMBER_TAGS = (_PLAIN_TAG + "int", _PLAIN_TAG + "float")
_LONG = 200  # characters: hours of arithmetic in base 60; a SHA-512 has 128
_ENDLESS = re.compile(rf"[-+0-9a-fA-FxX:_.]{{{_LONG},}}")
_STARTS = (yaml.MappingStartEvent, yaml.SequenceStartEvent)
_ENDS = (yaml.MappingEndEvent, yaml.SequenceEndEvent)
_RESOLVERS: Any = _Loader.yaml_implicit_resolvers  # patterns of plain scalars with their tags, by the first character
_CONSTRUCTOR: Any = yaml.constructor.SafeConstructor()
_CONSTRUCTED = {
    _PLAIN_TAG + name: _CONSTRUCTOR.yaml_constructors[_PLAIN_TAG + name] for name in ("null", "bool", "int", "float")
}
_NO_KEY = object()


class Bounds(msgspec.Struct, frozen=True, kw_only=True):
    """What a document may be.

    Attributes:
        size: Bytes (or characters) of it; a manifest of an hour with 500 events takes 0.2 MB.
        values: Scalars, lists and mappings in it, with every alias counted as what it stands for.
        depth: Lists and mappings within each other.
    """

    size: int = 8_000_000
    values: int = 200_000
    depth: int = 50


DEFAULT = Bounds()


class BadYaml(ValueError):
    """A text that is no YAML, or more than the bounds allow; the message is one short line that begins "not YAML"."""

    def __init__(self, problem: str, place: str = "") -> None:
        super().__init__(f"not YAML{place}: {problem}")


class _Open(NamedTuple):
    """A list or mapping whose end has not come: its anchor, and how many values there were before it."""

    anchor: str | None
    before: int


def load(text: str | bytes, bounds: Bounds = DEFAULT) -> Any:
    """Return the plain data of a document.

    Raises:
        BadYaml: not YAML, not plain data, or beyond the bounds.
    """
    if len(text) > bounds.size:
        raise BadYaml(f"more than {bounds.size} bytes")
    try:
        builder = _Builder()
        _survey(text, bounds, builder)
        return builder.document if builder.is_plain else yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or error
        raise BadYaml(_short(str(problem)), place) from None
    except BadYaml:
        raise
    except _ODD as error:
        raise BadYaml(f"a value that cannot be read ({_short(str(error) or type(error).__name__)})") from None


def read_bytes(path: Path, bounds: Bounds = DEFAULT) -> bytes:
    """Return the bytes of a file, of one that is too large only as many as make `load` refuse it.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return file.read(bounds.size + 1)


class _Builder:
    """Builds a document from its events.

    Attributes:
        is_plain: Whether it knows all that came: no tags, anchors, merges, dates, keys that are lists, second document.
    """

    def __init__(self) -> None:
        self.is_plain = True
        self._documents: list[Any] = []
        self._into: Any = self._documents  # the list or mapping that is being filled
        self._key: Any = _NO_KEY  # of the next value of a mapping
        self._outer: list[Any] = []

    @property
    def document(self) -> Any:
        """The plain data of the document; None of an empty one."""
        return self._documents[0] if self._documents else None

    def add_scalar(self, event: Any) -> None:
        if not self.is_plain:
            return
        value = event.value
        if event.tag is not None or event.anchor is not None:
            self.is_plain = False
        elif event.implicit[0] and (found := _RESOLVERS.get(value[:1])) is not None:
            tag = next((tag for tag, pattern in found if pattern.match(value)), None)
            if tag in _CONSTRUCTED:
                value = _CONSTRUCTED[tag](_CONSTRUCTOR, yaml.ScalarNode(tag, value))
            elif tag is not None:
                self.is_plain = False
        self._add(value)

    def begin(self, event: Any, value: list[Any] | dict[Any, Any]) -> None:
        is_key = self._key is _NO_KEY and type(self._into) is dict
        self.is_plain &= event.tag is None and event.anchor is None and not is_key
        if not self.is_plain:
            return
        self._add(value)
        self._outer.append(self._into)
        self._into = value

    def end(self) -> None:
        if self.is_plain:
            self._into = self._outer.pop()

    def _add(self, value: Any) -> None:
        if type(self._into) is list:
            self._into.append(value)
            self.is_plain &= len(self._documents) == 1
        elif self._key is _NO_KEY:
            self._key = value
        else:
            self._into[self._key] = value
            self._key = _NO_KEY


def _survey(text: str | bytes, bounds: Bounds, builder: _Builder) -> None:
    """Count what the document would become, and build it on the way as long as it is plain."""
    count, waiting, sizes = 0, list[_Open](), dict[str, int]()
    event: Any
    for event in yaml.parse(text, Loader=_Loader):
        kind = type(event)  # a manifest has thousands: each question counts
        if kind is yaml.ScalarEvent:
            if event.tag is not None or len(event.value) >= _LONG:
                _check_value(event)
            count += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
            builder.add_scalar(event)
        elif kind in _STARTS:
            _check_value(event)
            waiting.append(_Open(event.anchor, count))
            count += 1
            if len(waiting) > bounds.depth:
                raise BadYaml(f"lists and mappings more than {bounds.depth} deep")
            builder.begin(event, [] if kind is yaml.SequenceStartEvent else {})
        elif kind in _ENDS:
            anchor, before = waiting.pop()
            if anchor is not None:
                sizes[anchor] = count - before
            builder.end()
        elif kind is yaml.AliasEvent:
            name = event.anchor or ""
            if any(outer.anchor == name for outer in waiting):
                raise BadYaml(f"alias {name[:20]!r} stands within what it names")
            count += sizes.get(name, 1)
            builder.is_plain = False
        if count > bounds.values:
            raise BadYaml(f"more than {bounds.values} values, aliases counted as what they stand for")


def _check_value(event: Any) -> None:
    tag = event.tag
    if tag is not None and tag != "!" and (not tag.startswith(_PLAIN_TAG) or tag.startswith(_PLAIN_TAG + "python")):
        raise BadYaml(f"tag {_short(tag)!r}, expected plain data")
    if not isinstance(event, yaml.ScalarEvent) or not _ENDLESS.fullmatch(event.value):
        return
    if tag in _NUMBER_TAGS or (event.implicit[0] and _looks_like_a_number(event.value)):
        raise BadYaml(f"a number of {len(event.value)} characters")


def _looks_like_a_number(text: str) -> bool:
    """Whether a plain scalar is one to the loader; a hash, however long, is not."""
    known = _Loader.yaml_implicit_resolvers.get(text[0], ())
    return any(pattern.match(text) for tag, pattern in known if tag in _NUMBER_TAGS)


def _short(text: str) -> str:
    return " ".join(text.split())[:120]
