from __future__ import annotations

import msgspec
import pytest

from station.episode.storage.request import RecordRequest, parse_request
from station.errors import Refused


def test_a_request_without_a_plan_has_none() -> None:
    request = RecordRequest(id="1", action="start")
    assert parse_request(msgspec.json.encode(request)) == request
    assert request.planned_s is None


@pytest.mark.parametrize("field", ["operator", "runbook"])
def test_more_than_a_manifest_takes_is_refused(field: str) -> None:
    deep = b'{"a": ' * 40 + b"1" + b"}" * 40
    with pytest.raises(Refused, match="operator and runbook hold more than a manifest takes"):
        parse_request(b'{"id": "1", "action": "start", "%b": %b}' % (field.encode(), deep))


@pytest.mark.parametrize("planned", ["-1", "1e12", "-0.001"])
def test_a_plan_that_is_no_time_is_refused(planned: str) -> None:
    with pytest.raises(Refused, match=r"planned_s is .*, expected 0 to 2592000 seconds"):
        parse_request(b'{"id": "1", "action": "start", "planned_s": %b}' % planned.encode())
