"""A place where sessions run, with real servers on a real bus; and the person who answers, who is the test."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from station.bus.client import Bus
from station.life.events import Severity
from station.life.server import Health
from station.supervision import runbook
from station.supervision.session import Recording, Session
from station.supervision.supervisor import Supervisor
from tests.waiting import wait_until

HEAD = "runbook: t\nrobot: unitree_g1_with_hands\n"
ASK = "  - confirm: Nobody stands there.\n"
RECORDER = "  - start: recorder\n"
MOTION = "  - start: motion\n    with: {motion: 'builtin:wave', loop: true, enter_s: 0.1, leave_s: 0.1}\n"
QUICK = HEAD + "steps:\n" + ASK + RECORDER + MOTION


@dataclass
class Person:
    """Answers as told, and remembers what was shown."""

    answer: bool = True
    word: str = ""
    is_elsewhere: bool = False  # waits for somebody else to answer
    asked: Callable[[], None] = lambda: None
    told: list[str] = field(default_factory=list)
    shown: list[list[Health]] = field(default_factory=list)
    is_attended: bool = False
    offered: str = ""
    wants_restart: bool = False

    def begin(self, step: str) -> None:
        self.told.append(f"begin {step}")

    def done(self, step: str, result: str) -> None:
        self.told.append(f"done {step}: {result}")

    def failed(self, step: str, reason: str) -> None:
        self.told.append(f"failed {step}: {reason}")

    def report(self, text: str, severity: Severity = "info") -> None:
        self.told.append(f"{severity} {text}")

    def confirm(self, sentence: str, is_answered: Callable[[], bool]) -> bool:
        self.told.append(f"asked {sentence}")
        self.asked()
        if self.is_elsewhere:
            wait_until(is_answered)
        return self.answer

    def ask(self, question: str, answers: Sequence[str], is_answered: Callable[[], bool]) -> str:
        self.told.append(f"asked {question} {'/'.join(answers)}")
        self.asked()
        if self.is_elsewhere:
            wait_until(is_answered)
        return self.word

    def offer(self, restart: str) -> None:
        self.offered, self.wants_restart = restart, False  # a key that was pressed before does not count

    def pop_restart(self) -> bool:
        wanted, self.wants_restart = self.wants_restart, False
        return wanted

    def show(self, health: list[Health]) -> None:
        self.shown.append(health)

    def heard(self, text: str) -> bool:
        return any(text in line for line in self.told)


class Place:
    """A bus, a supervisor and a data folder."""

    def __init__(self, bus: Bus, folder: Path) -> None:
        self.bus, self.folder, self.data = bus, folder, folder / "data"
        self.supervisor = Supervisor(bus, folder / "logs", {"STATION_DATA": str(self.data)})
        self.stop = threading.Event()

    def session(self, text: str, person: Person, *, record: bool = False, unattended: bool = False) -> Session:
        path = self.folder / "book.yaml"
        path.write_text(text)
        recording = Recording(task="t", operator={"id": "ada"}) if record else None
        return Session(runbook.load(path), self.bus, self.supervisor, person, data=self.data, recording=recording,
                       is_unattended=unattended)  # fmt: skip
