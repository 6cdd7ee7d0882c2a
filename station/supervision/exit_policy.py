"""What becomes of a station when one of its servers dies or falls silent.

The robot needs no supervisor for its safety: the gate holds, returns to standing and stands. So where a person attends,
the station stays up, says what died and waits for the answer; nothing that moves a robot starts again by itself unless
the runbook says so.
"""

from __future__ import annotations

import getpass
from collections.abc import Callable, Sequence

from station.life.server import Health
from station.life.stop_file import LatchedStop
from station.supervision.runbook import Runbook
from station.supervision.runbook_publisher import TERMINAL, GivenAnswer, RunbookPublisher
from station.supervision.session_ui import SessionUI
from station.supervision.supervisor import Supervisor, how_it_ended

SILENT_S = 3.0
"""A process that lives and has said nothing for this long is taken for frozen [s]; it speaks twice a second."""


_DIED = "server-died"
_RESTART = "restart"


class ExitPolicy:
    """Watches over the servers of a session, a few times a second.

    Args:
        runbook: What it starts, and what is to be done if one dies.
        supervisor: Has the processes.
        face: Shows and asks.
        publisher: Asks on the bus.
        on_restart: Called with the names of servers that are started again, and who wanted it.
        is_unattended: Whether no person is asked, even where one is there.
    """

    def __init__(
        self,
        runbook: Runbook,
        supervisor: Supervisor,
        face: SessionUI,
        publisher: RunbookPublisher,
        on_restart: Callable[[str, GivenAnswer], None],
        *,
        is_unattended: bool,
    ) -> None:
        self._steps = {step.start: step for step in runbook.servers}
        self._supervisor, self._ui, self._publisher, self._on_restart = supervisor, face, publisher, on_restart
        self._latched: Callable[[], LatchedStop | None] = lambda: None
        self._asks = face.is_attended and not is_unattended
        self._dead: dict[str, str] = {}  # how, by name
        self._silent: set[str] = set()
        self._starting: set[str] = set()
        self._heard: dict[str, tuple[int, float]] = {}  # newest word, and when it came

    @property
    def are_open(self) -> bool:
        """Whether a server is dead now that was not started again."""
        return bool(self._dead)

    def check(
        self, health: Sequence[Health] | None, latched: Callable[[], LatchedStop | None] = lambda: None
    ) -> tuple[str, int] | None:
        """See what has died; return why the station should end, and an exit code, or None.

        Args:
            health: What the servers said last; None where the bus cannot tell.
            latched: Returns the stop under which nothing is started again.
        """
        self._latched = latched
        for name, code in self._supervisor.ended().items():
            step = self._steps[name]
            if name in self._dead:
                continue
            if code == 0 and step.kind.role == "command":
                return f"{name} has finished", int(self.are_open)
            how = how_it_ended(code)
            what = f"{how}; its last words: {self._supervisor.last_words(name)}"
            self._starting.discard(name)
            if not self._asks or step.if_it_dies == "end":
                self._supervisor.publish(_DIED, "error", server=name, reason=what)
                return f"server {name!r} {what}", 1
            self._dead[name] = how
            self._publish(name, what, _DIED)
        if health is None:
            self._heard.clear()  # no server could be heard: their time begins anew when the bus is back
        else:
            self._check_silent(health)
        if (self._dead or self._silent) and (given := self._taken()) is not None:
            if (stop := latched()) is not None:
                self._ui.report(f"{stop}; until then nothing starts", "error")
                self._offer()
            else:
                self._start_again(given)
        return None

    def _taken(self) -> GivenAnswer | None:
        """Return who wants the servers started again, at the terminal or on the bus."""
        typed = GivenAnswer(_RESTART, getpass.getuser(), TERMINAL) if self._ui.pop_restart() else None
        return self._publisher.pop_taken(typed)

    def _check_silent(self, health: Sequence[Health]) -> None:
        now_s = self._supervisor.clock.monotonic_s()
        for said in health:
            if said.name not in self._steps or said.name in self._dead:
                continue
            if self._heard.get(said.name, (0, 0.0))[0] != said.wall_ns:
                self._heard[said.name] = said.wall_ns, now_s
                self._on_health(said)
            elif now_s - self._heard[said.name][1] > SILENT_S and said.name not in self._silent | self._starting:
                self._silent.add(said.name)
                self._publish(said.name, f"lives, but has said nothing for {SILENT_S:g} s (frozen?)", "server-silent")

    def _on_health(self, said: Health) -> None:
        if said.name in self._silent:
            self._silent.discard(said.name)
            self._offer()
            self._supervisor.publish("server-back", "info", server=said.name)
        if said.name in self._starting and said.state == "active":
            self._starting.discard(said.name)
            self._supervisor.publish("server-active", "info", server=said.name, pid=said.pid)

    def _publish(self, name: str, what: str, event: str) -> None:
        keys = "; r starts it again, Ctrl-C takes the station down" if self._asks else ""
        self._supervisor.publish(event, "error", server=name, reason=what)
        self._offer()  # before it is said: a key that is pressed at the sight of the line counts
        self._ui.report(f"server {name!r} {what}{keys}", "error")

    def _offer(self) -> None:
        if not self._asks:
            return
        names = sorted({*self._dead, *self._silent})
        self._ui.offer(", ".join(names))
        hows = ", ".join(f"server {name!r} {self._dead.get(name, 'is silent')}" for name in names)
        self._publisher.offer(f"{hows}: start {' and '.join(names)} again?" if names else "", _RESTART, self._why_not)

    def _why_not(self) -> str:
        """Return why nothing is started again now, or ""."""
        return "" if (stop := self._latched()) is None else f"{stop}; until then nothing starts"

    def _start_again(self, given: GivenAnswer) -> None:
        names = sorted({*self._dead, *self._silent})
        self._on_restart(", ".join(names), given)
        for name in names:
            how = self._dead.pop(name, "was silent")
            self._silent.discard(name)
            self._heard.pop(name, None)
            self._starting.add(name)
            self._supervisor.publish("server-restarted", "warning", server=name, reason=how, who=given.who)
            self._supervisor.start_again(name)
        self._offer()
