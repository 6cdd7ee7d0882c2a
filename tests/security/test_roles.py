"""A user per role on a real server: each can do its work, and none can do another's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import acl, contracts, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer
from station.bus.tap import open_tap
from station.episode.reading.reader import open_episode
from station.errors import BusError
from station.life import estop, stop_file
from station.life.server import read_health
from station.life.stop_button import StopButton
from tests.security.conftest import As
from tests.servers.g1_station import PATIENT
from tests.waiting import DEADLINE_S, wait_until
from tests.web.console_process import ConsoleProcess

pytestmark = pytest.mark.usefixtures("processes")

ROBOT = twist_keys.TWIST2_ROBOT
MAY_WRITE = {"command": {"command"}, "state": {"low-level"}, "policy": {"low-level"}}
"""Who may write the keys of a contract's role, of those who are not the operator."""

FORBIDDEN = (
    "CONFIG SET dir /tmp", "CONFIG REWRITE", "SAVE", "BGSAVE", "SHUTDOWN NOSAVE", "FLUSHALL", "FLUSHDB",
    "EVAL return(1) 0", "FUNCTION LIST", "SCRIPT FLUSH", "MODULE LOAD x.so", "REPLICAOF example.com 1", "ACL LIST",
    "ACL SETUSER viewer allkeys", "CLIENT KILL ID 1", "CLIENT LIST", "MONITOR", "DEBUG SLEEP 1", "KEYS *", "DUMP a",
    "RESTORE a 0 x", "MIGRATE h 1 a 0 1", "RENAME a b", "SLOWLOG GET", "PUBLISH a b", "LATENCY DOCTOR",
)  # fmt: skip


def may_write(address: BusAddress, key: str) -> bool:
    connection = Connection(address, timeout_s=5.0)
    try:
        connection.call("MSET", key, b"0", keys.stamp(key), b"1 1 1 x.1.y.z")
    except BusError:  # NOPERM: everything else that is asked of a server works
        return False
    finally:
        connection.close()
    return True


def test_commands_states_and_policy_are_written_by_nobody_but_their_role(as_role: As) -> None:
    wrong = []
    for contract in contracts.contracts():
        expected = MAY_WRITE.get(contract.role)
        if expected is None:
            continue
        expected = expected | ({"operator"} if contract.role == "command" else set())
        found = {role for role in acl.ROLES if may_write(as_role(role), contract.key)}
        wrong += [(contract.key, found)] if found != expected else []
    assert wrong == []


def test_every_key_of_ours_has_a_role_that_writes_it(as_role: As) -> None:
    names = [contract.key for contract in contracts.contracts()]
    written = {key for role in acl.ROLES for key in names if may_write(as_role(role), key)}
    assert written == set(names)


def test_keys_of_a_robot_that_nothing_knows_have_their_roles_too(as_role: As) -> None:
    for key, role in (("action_walk_strider", "command"), ("state_feet_strider", "low-level")):
        expected = {role, "operator"} if role == "command" else {role}
        assert {one for one in acl.ROLES if may_write(as_role(one), key)} == expected


def test_viewers_press_the_stop_and_write_nothing_else(as_role: As) -> None:
    names = [*(contract.key for contract in contracts.contracts()), keys.ESTOP, keys.RECORD, "anything"]
    assert [key for key in names if may_write(as_role("viewer"), key)] == [keys.ESTOP_PRESSED]


def test_a_console_asks_and_answers_and_drives_nothing(as_role: As) -> None:
    own = [keys.server("console"), keys.server_config("console"), keys.clock("a"), keys.EVENT]
    asks = [keys.ARM, keys.RECORD, keys.MOTION_CONTROL, keys.RUNBOOK_ANSWER, keys.ESTOP, keys.ESTOP_PRESSED]
    names = [contract.key for contract in contracts.contracts()]
    names += ["action_walk_strider", keys.command_source(ROBOT), keys.host("a"), "anything"]
    found = [key for key in dict.fromkeys([*names, *own, *asks]) if may_write(as_role("console"), key)]
    assert sorted(found) == sorted([*own, *asks])


def test_only_the_operators_station_says_what_a_runbook_does_and_a_console_may_answer(as_role: As) -> None:
    assert [role for role in acl.ROLES if may_write(as_role(role), keys.RUNBOOK)] == ["operator"]
    assert {role for role in acl.ROLES if may_write(as_role(role), keys.RUNBOOK_ANSWER)} == {"console", "operator"}


def test_everybody_may_press_the_stop_and_only_operator_and_console_may_release_it(as_role: As) -> None:
    assert [role for role in acl.ROLES if may_write(as_role(role), keys.ESTOP_PRESSED)] == list(acl.ROLES)
    assert [role for role in acl.ROLES if may_write(as_role(role), keys.ESTOP)] == ["console", "operator"]
    with StopButton(as_role("operator")) as operator, StopButton(as_role("console")) as console:
        for role in acl.ROLES:
            with StopButton(as_role(role)) as button, Bus(as_role(role), name="t", timeout_s=5.0) as bus:
                button.press("a test")
                found = stop_file.on_bus(bus.address, bus.read(estop.KEYS).get)
                assert found is not None, role
                assert found.reason.endswith("a test"), role
                if role not in ("console", "operator"):
                    with pytest.raises(BusError, match=r"still latched .*NOPERM"):
                        button.release("a test")
                    for request in (["DEL", keys.ESTOP_PRESSED], ["GETDEL", keys.ESTOP_PRESSED]):
                        with pytest.raises(BusError, match="NOPERM"):
                            bus.call(*request)
            (console if role == "viewer" else operator).release("a test")
        with Bus(as_role("viewer"), name="t", timeout_s=5.0) as bus:
            assert stop_file.on_bus(bus.address, bus.read(estop.KEYS).get) is None


def test_a_stopped_robot_says_its_stop_again_as_its_own_role_and_never_over_a_release(as_role: As) -> None:
    with (
        StopButton(as_role("operator")) as operator,
        Bus(as_role("low-level"), name="g1", timeout_s=5.0) as robot,
    ):
        assert estop.restate(robot, "somebody came near", "g1")
        assert not estop.restate(robot, "somebody came near", "g1")
        assert estop.read(robot.get(keys.ESTOP_PRESSED) or b"", key=keys.ESTOP_PRESSED).reason == "somebody came near"
        operator.release("a test")
        assert not estop.restate(robot, "somebody came near", "g1")
        assert robot.get(keys.ESTOP_PRESSED) is None


def test_no_role_may_change_the_server_read_its_users_or_spy_on_it(as_role: As) -> None:
    for role in acl.ROLES:
        connection = Connection(as_role(role), timeout_s=5.0)
        for request in FORBIDDEN:
            with pytest.raises(BusError, match=r"NOPERM|not allowed"):
                connection.call(*request.split())
        connection.close()


def test_only_the_recorder_may_take_the_whole_stream(as_role: As) -> None:
    for role in acl.ROLES:
        if role == "recorder":
            tap = open_tap(as_role(role), backend="replication")
            assert tap.is_lossless
            tap.close()
        else:
            with pytest.raises(BusError):
                open_tap(as_role(role), backend="replication")


def test_settings_that_any_role_may_read_hold_no_secret(as_role: As, passwords: dict[str, str]) -> None:
    connection = Connection(as_role("viewer"), timeout_s=5.0)
    text = b" ".join(connection.call("CONFIG", "GET", "*"))
    connection.close()
    assert not [password for password in passwords.values() if password.encode() in text]
    assert not [password for password in passwords.values() if acl.sha256(password).encode() in text]


def test_strangers_and_wrong_passwords_are_refused_in_one_line(shared_bus: RedisServer, as_role: As) -> None:
    socket = shared_bus.address.socket
    for address in (
        BusAddress(socket=socket),
        BusAddress(socket=socket, username="viewer", password="guess"),
        BusAddress(socket=socket, password="guess"),
        BusAddress(socket=socket, username="root", password="guess"),
    ):
        with pytest.raises(BusError, match="password") as refused:
            Connection(address, timeout_s=5.0)
        assert "guess" not in str(refused.value)
        assert "\n" not in str(refused.value)


@contextmanager
def _server(name: str, address: BusAddress, file: Path, data: Path, *settings: str) -> Iterator[subprocess.Popen[str]]:
    """``station serve NAME``, which takes the user of its own role from a file that it is told of."""
    environment = {
        **os.environ, "STATION_BUS": address.url, "STATION_BUS_PASSWORD_FILE": str(file), "STATION_DATA": str(data),
    }  # fmt: skip
    sets = [word for setting in settings for word in ("--set", setting)]
    process = subprocess.Popen(
        [sys.executable, "-m", "station", "serve", name, *sets],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_whole_station_works_with_a_user_for_each_of_its_servers(
    as_role: As, password_file: Path, tmp_path: Path, passwords: dict[str, str]
) -> None:
    address, data = as_role("operator"), tmp_path / "data"
    with (
        Bus(address, name="operator", timeout_s=5.0) as bus,
        _server("g1", address, password_file, data, *PATIENT) as g1,
        _server("recorder", address, password_file, data) as recorder,
    ):
        wait_until(lambda: {h.name for h in read_health(bus) if h.state == "active"} >= {"g1", "recorder"})
        _ask_recorder(address, "start")
        with _server("motion", address, password_file, data, "motion=builtin:march", "loop=true") as motion:
            with bus.watch([keys.command_gate(ROBOT)]) as watch:
                wait_until(lambda: (s := watch.latest(keys.command_gate(ROBOT))) and b'"tracking"' in s.value)
            motion.send_signal(signal.SIGTERM)
            assert motion.wait(DEADLINE_S) == 0
        with StopButton(as_role("sensor")) as button, StopButton(address) as operator:
            button.press("smoke")
            assert button.unstopped(DEADLINE_S) == {}
            operator.release("all is well")
            assert operator.unreleased(DEADLINE_S) == []
        folder = _ask_recorder(address, "stop")
        lost = {health.name: health.lost_writes for health in read_health(bus)}
        for process in (g1, recorder):
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=DEADLINE_S)
            assert process.returncode == 0
            assert "NOPERM" not in said
    assert not any(lost.values()), lost
    reader = open_episode(folder)
    assert reader.manifest.recorder.backend == "replication"
    written = {twist_keys.action_body(), keys.robot_state(ROBOT), keys.policy_action(ROBOT), keys.ESTOP_PRESSED}
    assert written <= set(reader.topics())
    kept = b"".join(path.read_bytes() for path in data.rglob("*") if path.is_file())
    kept += b"".join(message.data for message in reader.messages())
    assert not [role for role, password in passwords.items() if password.encode() in kept]


def _ask_recorder(address: BusAddress, action: str) -> str:
    from station.episode.recorder import remote

    with Bus(address, name="cli", timeout_s=5.0) as bus:
        answer = remote.ask(bus, action, timeout_s=30.0, **({"task": "roles"} if action == "start" else {}))  # type: ignore[arg-type]
    assert answer.path is not None
    return answer.path


def test_a_server_whose_user_may_not_speak_for_it_says_so_and_does_not_start(
    as_role: As, password_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATION_BUS_USER", "viewer")
    with _server("motion", as_role("viewer"), password_file, tmp_path, "motion=builtin:march") as motion:
        _, said = motion.communicate(timeout=DEADLINE_S)
    assert motion.returncode == 1
    assert "user 'viewer' of the bus may not write station:server:motion; expected user 'command'" in said


def test_status_and_doctor_work_for_a_viewer(as_role: As, password_file: Path) -> None:
    environment = {
        **os.environ, "STATION_BUS": str(as_role("viewer")), "STATION_BUS_USER": "viewer",
        "STATION_BUS_PASSWORD_FILE": str(password_file),
    }  # fmt: skip
    for verb, code in (("status", 0), ("doctor", 1)):  # nothing runs, which the doctor finds
        done = subprocess.run(
            [sys.executable, "-m", "station", verb], capture_output=True, text=True, env=environment, check=False
        )
        assert done.returncode == code, done.stderr
        assert "NOPERM" not in done.stdout + done.stderr
    assert "bus access" in done.stdout


def test_a_console_of_its_own_role_stops_releases_and_asks(as_role: As, tmp_path: Path) -> None:
    pytest.importorskip("starlette", reason="needs the extra 'console'")
    console = ConsoleProcess(as_role("console"), tmp_path)
    page = console.page()
    try:
        page.state(lambda state: state["bus"]["linked"])
        page.say(t="stop", id="one", key=console.stop_key())
        assert page.until(lambda said: said["t"] == "stop")["said"] == "taken"
        with Bus(as_role("operator"), name="look", timeout_s=5.0) as bus:
            assert estop.latched(bus.read(estop.KEYS).get) is not None
            assert page.ask("release")["ok"]
            assert estop.latched(bus.read(estop.KEYS).get) is None
        assert "recorder" in page.ask("record.start", task="x")["text"]
        assert "NOPERM" not in console.words()
    finally:
        page.close()
        console.kill()
