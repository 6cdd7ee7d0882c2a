"""The motion switcher: which of the robot's own controllers has the motors, and having it let go. Never waits.

Requests are broadcast, and so are answers, which are matched by id. Source: ``motion_switcher`` of
unitreerobotics/unitree_sdk2.
"""

from __future__ import annotations

import math

from adapters.robots.g1.dds import topics, types, words
from adapters.robots.g1.dds.network import Network, raw
from station.clock import Clock

CHECK, RELEASE = 1001, 1003
_ASKS_EVERY_S = 0.5
_RELEASES_WITHIN_S = 10.0  # the SDK's own examples ask again for up to ten seconds


class Switcher:
    """Asks twice a second who has the motors; `poll` in each period.

    Args:
        network: The robot's.
        clock: Of the process.

    Attributes:
        controller: Name of the controller that has the motors; "" for none; None while it is not known.
        answered_s: When it was last answered, by the clock; -inf before.
        refused: Why the last release came to nothing, or "".
    """

    def __init__(self, network: Network, clock: Clock) -> None:
        self._clock = clock
        self._requests = network.writer(topics.SWITCHER_REQUEST, raw(types.Request))
        self._answers = network.reader(topics.SWITCHER_RESPONSE, types.Response, depth=32)
        self._asked: dict[int, int] = {}
        self._asked_s = -math.inf
        self._releasing_until_s = -math.inf
        self.controller: str | None = None
        self.answered_s = -math.inf
        self.refused = ""

    @property
    def is_releasing(self) -> bool:
        """Whether a release is under way."""
        return self._releasing_until_s > -math.inf

    def release(self) -> None:
        """Have the controller let go of the motors: the robot is limp at once."""
        self.refused = ""
        self._releasing_until_s = self._clock.monotonic_s() + _RELEASES_WITHIN_S
        self._ask(RELEASE)

    def poll(self) -> None:
        """Read answers, and ask again where it is time."""
        now_s = self._clock.monotonic_s()
        for answer in filter(None, map(words.answer_of, self._answers.take())):
            api = self._asked.pop(answer.number, 0)
            if api == CHECK and answer.code == 0:
                self._on_name(answer.text, now_s)
            elif api == RELEASE and answer.code != 0:
                self._end(f"the motion switcher said no (code {answer.code})")
        if self.is_releasing and now_s > self._releasing_until_s:
            still = f"{self.controller!r} holds the motors" if self.controller else "the motion switcher did not answer"
            self._end(f"after {_RELEASES_WITHIN_S:g} s {still}; on the remote: L2+B, then L2+R2")
        if now_s - self._asked_s >= _ASKS_EVERY_S:
            self._asked_s = now_s
            if self.is_releasing and self.controller:
                self._ask(RELEASE)
            self._ask(CHECK)

    def _on_name(self, data: str, now_s: float) -> None:
        if (name := words.name_of(data)) is None:
            return  # no answer of a switcher; the next one is half a second away
        self.controller, self.answered_s = name, now_s
        if self.is_releasing and not self.controller:
            self._end("")

    def _end(self, refused: str) -> None:
        self.refused, self._releasing_until_s = refused, -math.inf

    def _ask(self, api: int) -> None:
        asked = max(self._clock.monotonic_ns(), max(self._asked, default=0) + 1)
        self._asked = {key: value for key, value in self._asked.items() if asked - key < 10_000_000_000}
        self._asked[asked] = api
        self._requests.write(words.request(asked, api))
