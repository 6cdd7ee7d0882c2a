"""Of each feed the newest frame, and one on its way to each viewer."""

from __future__ import annotations

import json
from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st

from station.web.feeds import MOST_WANTED, Feeds, Frame, Viewer


def _frame(name: str, number: int) -> Frame:
    return Frame({"f": name, "number": number}, b"%d" % number, 1.0)


def _next(viewer: Viewer) -> tuple[str, bytes] | None:
    """Return the frame that may go out now; None where none may."""
    found = viewer.take()
    return None if found is None else (found[0], found[1].payload)


def test_a_slow_viewer_gets_the_newest_and_holds_up_nobody() -> None:
    feeds = Feeds()
    slow, fast = feeds.join(), feeds.join()
    for viewer in (slow, fast):
        viewer.want(["a"])
    for number in range(5):
        feeds.put({"a": _frame("a", number)})
        assert _next(fast) == ("a", b"%d" % number)
        fast.got("a")
        assert _next(slow) == (("a", b"0") if number == 0 else None)
    slow.got("a")
    assert _next(slow) == ("a", b"4")


def test_pages_may_come_and_go_while_another_thread_asks_what_is_wanted() -> None:
    """A console died of it: its loop went through the viewers as one joined."""
    feeds = Feeds()

    class Asked(frozenset[str]):
        def __iter__(self) -> Iterator[str]:
            feeds.leave(feeds.join())
            feeds.join()
            return super().__iter__()

    for name in ("a", "b"):
        feeds.join().wanted = Asked({name})
    assert feeds.wanted == {"a", "b"}


def test_a_frame_that_waits_is_sent_once() -> None:
    feeds = Feeds()
    viewer = feeds.join()
    feeds.put({"a": _frame("a", 1)})
    viewer.want(["a"])
    assert _next(viewer) == ("a", b"1")
    viewer.got("a")
    assert _next(viewer) is None


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from(["put", "got", "next"])), max_size=60))
def test_never_two_of_a_feed_under_way_and_never_an_older_one(steps: list[tuple[str, str]]) -> None:
    feeds = Feeds()
    viewer = feeds.join()
    viewer.want("abc")
    newest, under_way, seen = dict.fromkeys("abc", 0), set[str](), dict.fromkeys("abc", 0)
    for number, (name, act) in enumerate(steps, 1):
        if act == "put":
            newest[name] = number
            feeds.put({name: _frame(name, number)})
        elif act == "got":
            under_way.discard(name)
            viewer.got(name)
        elif (found := _next(viewer)) is not None:
            sent, payload = found
            assert sent not in under_way
            assert int(payload) == newest[sent] > seen[sent]
            under_way.add(sent)
            seen[sent] = int(payload)
        else:
            assert all(name in under_way or newest[name] == seen[name] for name in "abc")


def test_feeds_that_nobody_wants_are_not_asked_for() -> None:
    feeds = Feeds()
    viewer = feeds.join()
    viewer.want([f"robot:{number}" for number in range(1000)])
    assert len(feeds.wanted) == MOST_WANTED
    feeds.leave(viewer)
    assert feeds.wanted == frozenset()


def test_a_frame_says_how_old_it_is_when_it_goes_out() -> None:
    data = Frame({"f": "a"}, b"\x00" * 8, taken_s=10.0).packed(10.25)
    length = int.from_bytes(data[:4], "little")
    assert (4 + length) % 8 == 0  # so that numbers behind it are read in place
    assert json.loads(data[4 : 4 + length]) == {"f": "a", "age_ms": 250.0}
    assert data[4 + length :] == b"\x00" * 8
