"""A node of ROS 2 for tests: does what lines of JSON on its standard input say, and answers each with one.

Runs in the Python of a ROS 2, so it imports nothing of the station or of its tests.
"""

import array
import importlib
import json
import statistics
import sys
import threading
import time

import rclpy
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

IDLE_S = 1.0


def found(name):
    package, kind, word = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), word)


def filled(message, fields):
    """Fill a message; octets and arrays of them are hexadecimal."""
    for name, value in fields.items():
        part = getattr(message, name)
        if isinstance(value, dict):
            filled(part, value)
        elif value and isinstance(value, list) and isinstance(value[0], dict):
            kind = message.get_fields_and_field_types()[name].removeprefix("sequence<").removesuffix(">")
            setattr(message, name, [filled(found(kind.replace("/", "/msg/"))(), one) for one in value])
        elif isinstance(part, bytes):
            setattr(message, name, bytes.fromhex(value))
        elif isinstance(part, array.array) and part.typecode == "B":
            setattr(message, name, array.array("B", bytes.fromhex(value)))
        else:
            setattr(message, name, value)
    return message


def plain(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes | bytearray):
        return value.hex()
    if isinstance(value, array.array) and value.typecode == "B":
        return value.tobytes().hex()
    if isinstance(value, str | int | float | bool):
        return value
    return [plain(one) for one in value]


class Doer:
    def __init__(self, node):
        self.node = node
        self.publishers = {}
        self.sending = {}
        self.kept = {}
        self.subscriptions = []

    def hello(self):
        return "hello"

    def publish(self, topic, kind, rate_hz, best_effort, fields):
        if topic not in self.publishers:
            reliability = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE
            made = self.node.create_publisher(found(kind), topic, QoSProfile(depth=10, reliability=reliability))
            self.publishers[topic] = made
        self.sending[topic] = (filled(found(kind)(), fields), 1.0 / rate_hz, [0.0])

    def burst(self, topics, rate_hz, count):
        """Publish on all topics, one after the other, again and again; return how long each waits for those before it,
        at the median [ms], and what all of it costs [% of a core]."""
        for topic, kind in topics.items():
            if topic not in self.publishers:
                self.publishers[topic] = self.node.create_publisher(found(kind), topic, 10)
        made = [(self.publishers[topic], found(kind)()) for topic, kind in topics.items()]
        while not all(publisher.get_subscription_count() for publisher, _ in made):
            time.sleep(0.01)
        waits, spent_s = [[] for _ in made], time.process_time()
        time.sleep(IDLE_S)
        idle, began_s, spent_s = (time.process_time() - spent_s) / IDLE_S, time.monotonic(), time.process_time()
        for number in range(count):
            first_ns = time.monotonic_ns()
            for (publisher, message), waited in zip(made, waits, strict=True):
                waited.append((time.monotonic_ns() - first_ns) * 1e-6)
                publisher.publish(message)
            time.sleep(max(0.0, began_s + (number + 1) / rate_hz - time.monotonic()))
        load = (time.process_time() - spent_s) / (time.monotonic() - began_s) - idle
        return {"wait_ms": [statistics.median(waited) for waited in waits], "load": 100.0 * load}

    def cease(self, topic):
        self.sending.pop(topic, None)

    def listen(self, topic, kind):
        kept = self.kept[topic] = []
        self.subscriptions.append(
            self.node.create_subscription(found(kind), topic, lambda m: kept.append((time.time_ns(), m)), 1000)
        )

    def heard(self, topic):
        return [{"at_ns": at_ns, **plain(message)} for at_ns, message in list(self.kept[topic])]

    def call(self, service, kind, fields):
        client = self.node.create_client(found(kind), service)
        if not client.wait_for_service(timeout_sec=20.0):
            raise TimeoutError(f"{service} is not there")
        future = client.call_async(filled(found(kind).Request(), fields))
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        if not done.wait(20.0):
            raise TimeoutError(f"{service} did not answer")
        return plain(future.result())

    def send_due(self):
        while True:
            now_s = time.monotonic()
            for topic, (message, period_s, due_s) in list(self.sending.items()):
                if now_s >= due_s[0]:
                    due_s[0] = max(due_s[0] + period_s, now_s - period_s)
                    if hasattr(message, "header") and message.header.frame_id == "now":
                        message.header.stamp = self.node.get_clock().now().to_msg()
                    self.publishers[topic].publish(message)
            time.sleep(0.001)


def main():
    rclpy.init()
    node = rclpy.create_node("peer")
    executor = MultiThreadedExecutor(2)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    doer = Doer(node)
    threading.Thread(target=doer.send_due, daemon=True).start()
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            answer = {"answer": getattr(doer, asked.pop("what"))(**asked)}
        except Exception as error:  # noqa: BLE001  # told to the test
            answer = {"error": repr(error)}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    rclpy.try_shutdown()
    node.destroy_node()


if __name__ == "__main__":
    main()
