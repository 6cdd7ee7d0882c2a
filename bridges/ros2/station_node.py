#!/usr/bin/env python3
"""The ROS 2 node of Teleop Station's bridge: `rclpy` and the standard library, Python 3.10 or newer, nothing else.

The server ``ros2`` of the station starts it with the Python of a ROS installation, and talks to it over standard input
and output, so it needs no address, no password and no package of the station. It translates nothing: messages pass as
the bytes that ROS sends (CDR), and which topic is which is told by the server. It counts what it has published.

A frame on either pipe is a head (`HEAD`) and so many bytes:

====  ===========  ==========================================================================================
kind  to           what
====  ===========  ==========================================================================================
c     the node     JSON: topics, services, domain; the first frame
m     the node     a message for a topic; the time is when its value was written
e     the node     a topic's commands end: its last word is published, `ENDS` times
r     the node     JSON: the answer to a service call
h     the server   JSON: what was published, who listens; five times a second
m     the server   a message of a topic; the time is when it was published, 0 where that is unknown
q     the server   JSON: somebody calls a service
x     the server   JSON: why the node cannot run; the last frame
====  ===========  ==========================================================================================

Times are nanoseconds since the epoch. Where standard input ends, so does the node.
"""

import contextlib
import importlib
import inspect
import json
import math
import os
import signal
import statistics
import struct
import sys
import threading
import time
from collections import deque

HEAD = struct.Struct("<IcHqqI")
"""Bytes that follow, kind, number of the topic, time of the message [ns], when whoever sends the frame got it [ns], and
which publisher it is of, from 1 (0 where that is unknown)."""

BEAT_S = 0.2
LEAVES_S = 1.0
ENDS, END_EVERY_S = 10, 0.02
"""How often the last word of a topic is published, and how far apart: one may be lost."""

ANSWER_S = 15.0
"""Longest wait for the station's answer to a service call [s]."""

WAIT_NS = 100_000_000
_KEPT = 200  # newest ages of which a heartbeat says the median
_LONGEST = 64 << 20  # bytes of a frame


class Line:
    """Frames in on one descriptor, out on another; sending is safe from every thread."""

    def __init__(self, source, target):
        self._source, self._target = source, target
        self._lock = threading.Lock()

    def receive(self):
        """Return the next frame: kind, number, its two times, bytes; None at the end."""
        head = self._source.read(HEAD.size)
        if len(head) < HEAD.size:
            return None
        size, kind, number, at_ns, got_ns, _ = HEAD.unpack(head)
        if size > _LONGEST:
            return None
        data = self._source.read(size)
        return (kind, number, at_ns, got_ns, data) if len(data) == size else None

    def send(self, kind, data, number=0, at_ns=0, got_ns=0, sender=0):
        """Write a frame, whole, as soon as the server takes it."""
        frame = HEAD.pack(len(data), kind, number, at_ns, got_ns, sender) + data
        with self._lock:
            while frame:
                frame = frame[os.write(self._target, frame) :]

    def say(self, kind, **facts):
        """Write a frame of JSON."""
        self.send(kind, json.dumps(facts).encode())


class Unusable(Exception):
    """Something that the server asked for is not in this ROS installation; one line."""


class Outgoing:
    """A topic that the station publishes.

    Attributes:
        published: Messages since the start.
        ended_by: Why its commands ended last: "silence" or "told"; "" while they come, or before the first.
    """

    def __init__(self, node, row):
        self.topic, self._end, self._after_s = row["topic"], bytes.fromhex(row["end"]), row["end_after_s"]
        self.publisher = node.create_publisher(found(row["type"]), self.topic, qos(row["qos"]))
        self.published, self.ended_by = 0, ""
        self._ages_ms, self._delays_ms = deque(maxlen=_KEPT), deque(maxlen=_KEPT)
        self._came_s = self._again_s = 0.0
        self._ends = 0
        self._lock = threading.Lock()

    def publish(self, data, written_ns, got_ns):
        """Publish a message whose value was written at an instant, and came to the server at another [ns]."""
        with self._lock:
            self._came_s, self._ends, self.ended_by = time.monotonic(), 0, ""
            now_ns = time.time_ns()
            self.publisher.publish(data)
            self.published += 1
            self._ages_ms.append((now_ns - written_ns) * 1e-6)
            self._delays_ms.append((now_ns - got_ns) * 1e-6)

    def end(self, why):
        """Say the last word soon, if the topic has one and is being commanded."""
        with self._lock:
            if self._end and self._came_s:
                self._came_s, self._ends, self.ended_by = 0.0, ENDS, why

    @property
    def due_s(self):
        """When something of it is due, on the monotonic clock [s]: its last word, or its end for silence."""
        with self._lock:
            if self._ends:
                return self._again_s
            return self._came_s + self._after_s if self._end and self._came_s else math.inf

    def on_tick(self):
        """Publish what is due of the last word; end what has been silent for too long."""
        now_s = time.monotonic()
        if self._end and self._came_s and now_s - self._came_s > self._after_s:
            self.end("silence")
        with self._lock:
            if self._ends and now_s >= self._again_s:
                self._ends, self._again_s = self._ends - 1, now_s + END_EVERY_S
                self.publisher.publish(self._end)

    @property
    def is_ending(self):
        """Whether a last word is still due."""
        return self._ends > 0

    def facts(self):
        """Return what the server is told."""
        with self._lock:
            kept = {"age_ms": list(self._ages_ms), "delay_ms": list(self._delays_ms)}
        told = {
            name: [round(statistics.median(found), 3), round(max(found), 3)] for name, found in kept.items() if found
        }
        listeners = self.publisher.get_subscription_count()
        return {"published": self.published, "peers": listeners, "ended_by": self.ended_by, **told}


class LeftOut:
    """A topic of a type that this ROS installation has not: nothing is published, and that is told."""

    is_ending, due_s = False, math.inf

    def __init__(self, row):
        package = row["type"].split("/")[0]
        self._trouble = f"{row['topic']}: {row['type']} is not in this ROS installation; install {package}"

    def publish(self, *_):
        """Publish nothing."""

    def end(self, why):
        """Nobody is driven."""

    def on_tick(self):
        """Nothing is due."""

    def facts(self):
        """Return what the server is told."""
        return {"published": 0, "peers": 0, "trouble": self._trouble}


def is_there(row):
    """Whether the type of a topic is in this ROS installation."""
    try:
        found(row["type"])
    except Unusable:
        return False
    return True


class Incoming:
    """A topic that the station hears."""

    def __init__(self, node, number, row, line):
        self.topic, self._node, self._number, self._line = row["topic"], node, number, line
        self.missed, self.came = 0, 0
        self._newest = {}  # number of the newest message, by publisher
        self._senders = {}
        self.subscription = node.create_subscription(
            found(row["type"]), self.topic, lambda _: None, qos(row["qos"]), raw=True
        )

    def take_all(self):
        """Pass on every message that is there."""
        handle, kind = self.subscription.handle, self.subscription.msg_type
        while (taken := handle.take_message(kind, True)) is not None:
            self._pass_on(*taken)

    def _pass_on(self, data, info):
        self.came, got_ns = self.came + 1, time.time_ns()
        gid = info.get("publisher_gid") or b""  # from Kilted on
        gid = bytes(gid["data"]) if isinstance(gid, dict) else bytes(gid)
        sender = self._senders.setdefault(gid, len(self._senders) + 1) if gid and len(self._senders) < 1000 else 0
        count = info.get("publication_sequence_number") or 0  # from Iron on
        if sender and count:
            skipped = count - self._newest.get(gid, count) - 1
            self.missed += max(0, min(skipped, 1000))
            self._newest[gid] = count
        self._line.send(b"m", bytes(data), self._number, info.get("source_timestamp") or 0, got_ns, sender)

    def facts(self):
        """Return what the server is told."""
        return {"came": self.came, "missed": self.missed, "peers": self._node.count_publishers(self.topic)}


def listen(node, incoming, ended):
    """Pass on what comes until the node ends: what `rclpy.wait_for_message` does, for several topics, and again.

    An executor of rclpy costs several times as much for each message.
    """
    from rclpy.impl.implementation_singleton import rclpy_implementation

    waiting = rclpy_implementation.WaitSet(len(incoming), 0, 0, 0, 0, 0, node.context.handle)
    while not ended.is_set():
        waiting.clear_entities()
        for each in incoming:
            waiting.add_subscription(each.subscription.handle)
        waiting.wait(WAIT_NS)
        ready = waiting.get_ready_entities("subscription")
        for each in incoming:
            if each.subscription.handle.pointer in ready:
                each.take_all()


def answer(node):
    """Answer calls until the node ends."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


class Services:
    """Calls of services, answered by the station; on a thread of their own, so that none delays a topic.

    Args:
        node: Of ROS, on which nothing else is.
        rows: ``{"name", "type"}`` of each.
        line: To the server.
    """

    def __init__(self, node, rows, line):
        self._line, self._answers, self._number = line, {}, 0
        self._arrived = threading.Condition()
        for row in rows:
            kind = found(row["type"])
            node.create_service(kind, row["name"], lambda *call, name=row["name"]: self._on_call(name, *call))

    def _on_call(self, name, request, response):
        with self._arrived:
            self._number += 1
            number = self._number
        self._line.say(b"q", service=name, number=number, data=getattr(request, "data", None))
        with self._arrived:
            self._arrived.wait_for(lambda: number in self._answers, ANSWER_S)
            answer = self._answers.pop(number, None) or {"success": False, "message": "the station did not answer"}
        response.success, response.message = answer["success"], answer["message"]
        return response

    def on_answer(self, answer):
        """Take the station's answer."""
        with self._arrived:
            self._answers[answer["number"]] = answer
            self._arrived.notify_all()


def found(name):
    """Return the class of a type such as ``sensor_msgs/msg/Imu``."""
    package, kind, word = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), word)
    except (ImportError, AttributeError) as error:
        raise Unusable(
            f"{name} is not in this ROS installation ({error}); install {package}, or leave its row out"
        ) from None


def qos(row):
    """Return a QoS profile: depth, whether reliable, whether kept for those who come later."""
    from rclpy import qos as kinds

    return kinds.QoSProfile(
        depth=row["depth"],
        reliability=kinds.ReliabilityPolicy[row["reliability"].upper()],
        durability=kinds.DurabilityPolicy[row["durability"].upper()],
    )


def keep_to_this_computer():
    """Have ROS discover nobody on another computer; which variable says so depends on the release."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # from Iron on
    if os.environ.get("ROS_DISTRO", "") in ("foxy", "galactic", "humble"):
        os.environ["ROS_LOCALHOST_ONLY"] = "1"
    else:
        os.environ.pop("ROS_LOCALHOST_ONLY", None)
        os.environ.pop("ROS_STATIC_PEERS", None)


def run(line, config):
    """Publish, hear and answer until the server's pipe ends."""
    if config["localhost"]:
        keep_to_this_computer()
    if config["domain"] is not None:
        os.environ["ROS_DOMAIN_ID"] = str(config["domain"])
    try:
        import rclpy
    except ImportError as error:
        raise Unusable(f"{sys.executable} has no rclpy ({error})") from None
    rclpy.init(args=[], **without_signals(rclpy))
    node = rclpy.create_node(config["node"], start_parameter_services=False)
    outgoing = [Outgoing(node, row) if is_there(row) else LeftOut(row) for row in config["publish"]]
    incoming = [Incoming(node, number, row, line) for number, row in enumerate(config["subscribe"])]
    services, ended, woken = None, threading.Event(), threading.Event()
    nodes, answering = [node], None
    if config["services"]:
        aside = rclpy.create_node(config["node"] + "_services", start_parameter_services=False)
        nodes.append(aside)
        services = Services(aside, config["services"], line)
        answering = begun(answer, aside)
    listening = begun(listen, node, incoming, ended) if incoming else None
    begun(hear, line, outgoing, services, ended, woken)
    ros = {"distro": os.environ.get("ROS_DISTRO", ""), "rmw": rclpy.get_rmw_implementation_identifier()}
    beat_s = 0.0
    while not ended.is_set():
        woken.wait(max(0.0, min([beat_s, *(each.due_s for each in outgoing)]) - time.monotonic()))
        woken.clear()
        for each in outgoing:
            each.on_tick()
        if time.monotonic() >= beat_s:
            beat_s = time.monotonic() + BEAT_S
            try:
                tell(line, outgoing, incoming, ros)
            except OSError:  # the server was killed; the last words are still said
                break
    for each in outgoing:
        each.end("told")
    while any(each.is_ending for each in outgoing):
        time.sleep(END_EVERY_S)
        for each in outgoing:
            each.on_tick()
    with contextlib.suppress(OSError):
        tell(line, outgoing, incoming, ros)
    begun(leave, rclpy, nodes, listening, answering).join(LEAVES_S)  # threads of ROS may wait for ever in C


def begun(act, *given):
    """Return a thread that does something from now on."""
    thread = threading.Thread(target=act, args=given, daemon=True)
    thread.start()
    return thread


def leave(rclpy, nodes, listening, answering):
    """Leave the graph: who just ends leaves megabytes in shared memory, which nobody takes away."""
    if listening is not None:  # it waits on what a shutdown takes away
        listening.join()
    rclpy.try_shutdown()
    if answering is not None:  # what it uses is not destroyed before it ends
        answering.join()
    for node in nodes:
        node.destroy_node()


def without_signals(rclpy):
    """Return the arguments with which rclpy leaves signals alone: the pipe says when this process ends."""
    options = getattr(importlib.import_module("rclpy.signals"), "SignalHandlerOptions", None)
    takes = "signal_handler_options" in inspect.signature(rclpy.init).parameters
    return {"signal_handler_options": options.NO} if options is not None and takes else {}


def tell(line, outgoing, incoming, ros):
    """Send a heartbeat."""
    line.say(b"h", publish=[each.facts() for each in outgoing], subscribe=[each.facts() for each in incoming], **ros)


def hear(line, outgoing, services, ended, woken):
    """Do what the server sends until its pipe ends; wake who says last words."""
    try:
        while (frame := line.receive()) is not None:
            kind, number, at_ns, got_ns, data = frame
            if kind == b"m":
                outgoing[number].publish(data, at_ns, got_ns)
            elif kind == b"e":
                outgoing[number].end("told")
                woken.set()
            elif kind == b"r":
                services.on_answer(json.loads(data))
    finally:
        ended.set()
        woken.set()


def main():
    """Run as a child of the server; return the exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # Ctrl-C is for the server, which ends this process by its pipe
    target = os.dup(1)
    os.dup2(2, 1)  # what libraries print must not stand between frames
    line = Line(sys.stdin.buffer, target)
    first = line.receive()
    if first is None or first[0] != b"c":
        sys.stderr.write("this is started by Teleop Station: station serve ros2\n")
        return 2
    try:
        run(line, json.loads(first[-1]))
    except Unusable as error:
        line.say(b"x", reason=str(error))
        return 3
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads of ROS may wait for ever in C
