from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader

from adapters.exports.ros2 import messages
from adapters.exports.ros2.bag import METADATA, Bag
from tests.adapters.exports.ros2.read_back import HUMBLE, connections

BEGIN_NS = 1_795_000_000_123_456_789


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag with two messages of one topic, one of another, and a topic without any."""
    folder = tmp_path / "talk"
    folder.mkdir()
    with (folder / "talk_0.mcap").open("xb") as file:
        made = Bag(folder, file, {"task": "wave"})
        made.add_topic("/said", messages.TEXT, facts={"key": "said"})
        made.add_topic("/tf_static", messages.TRANSFORMS, is_latched=True, facts={})
        made.add_topic("/silent", messages.TEXT, facts={})
        made.write("/said", messages.text("one"), log_ns=BEGIN_NS + 7, publish_ns=BEGIN_NS, sequence=3)
        made.write("/said", messages.text("two"), log_ns=BEGIN_NS + 1_000, publish_ns=BEGIN_NS + 900, sequence=4)
        placed = messages.transform(BEGIN_NS, "a", "b", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        made.write("/tf_static", placed, log_ns=BEGIN_NS, publish_ns=BEGIN_NS)
        made.finish()
    return folder


def test_rosbags_finds_what_the_metadata_say(bag: Path) -> None:
    with Reader(bag) as reader:
        assert (reader.start_time, reader.end_time, reader.duration) == (BEGIN_NS, BEGIN_NS + 1_001, 1_001)
        assert reader.message_count == 3
        assert [(one.topic, log_ns) for one, log_ns, _ in reader.messages()] == [
            ("/tf_static", BEGIN_NS), ("/said", BEGIN_NS + 7), ("/said", BEGIN_NS + 1_000)
        ]  # fmt: skip
    facts = yaml.safe_load((bag / METADATA).read_text())["rosbag2_bagfile_information"]
    assert (facts["storage_identifier"], facts["custom_data"]) == ("mcap", {"task": "wave"})
    assert {one["topic_metadata"]["name"]: one["message_count"] for one in facts["topics_with_message_count"]} == {
        "/said": 2, "/tf_static": 1, "/silent": 0
    }  # fmt: skip


def test_every_release_from_humble_on_reads_the_metadata(bag: Path) -> None:
    text = (bag / METADATA).read_text()
    facts = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert facts["version"] == 8
    profiles = [one["topic_metadata"]["offered_qos_profiles"] for one in facts["topics_with_message_count"]]
    assert all(isinstance(one, str) for one in profiles), "Humble reads text there, and numbers in it"
    assert {type(value) for one in profiles for value in yaml.safe_load(one)[0].values()} == {int, bool, dict}
    assert "&" not in text


def test_whoever_subscribes_gets_it_and_who_comes_late_gets_what_stands_still(bag: Path) -> None:
    (said,) = connections(bag)["/said"].ext.offered_qos_profiles
    (placed,) = connections(bag)["/tf_static"].ext.offered_qos_profiles
    assert (said.reliability, said.history, said.depth) == (QosReliability.RELIABLE, QosHistory.KEEP_LAST, 10)
    assert (said.durability, placed.durability) == (QosDurability.VOLATILE, QosDurability.TRANSIENT_LOCAL)


def test_the_file_is_an_mcap_of_profile_ros2_whose_channels_carry_definition_hash_and_key(bag: Path) -> None:
    with (bag / "talk_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        schema, channel, message = next(reader.iter_messages(topics=["/said"]))
        (record,) = [one for one in reader.iter_metadata() if one.name == "rosbag2"]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("std_msgs/msg/String", "ros2msg", "cdr")
    assert schema.data.decode().split() == ["string", "data"]
    assert channel.metadata["key"] == "said"
    assert channel.metadata["topic_type_hash"] == HUMBLE.hash_rihs01("std_msgs/msg/String")
    assert (message.log_time, message.publish_time, message.sequence) == (BEGIN_NS + 7, BEGIN_NS, 3)
    both = yaml.safe_load((bag / METADATA).read_text())["rosbag2_bagfile_information"]
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == both
