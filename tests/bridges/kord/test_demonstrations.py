"""Each demonstration fails and is cured by one setting; what else it shows is tested with ``station kassow``."""

from __future__ import annotations

import dataclasses

import pytest
from station_kord import demonstrations


@pytest.mark.parametrize("name", demonstrations.names())
def test_a_failure_and_its_cure_differ_in_one_setting_which_both_name(name: str) -> None:
    shown = demonstrations.find(name)
    differing = [
        field.name
        for faulty, cured in ((shown.faulty.profile, shown.cured.profile), (shown.faulty.sim, shown.cured.sim))
        for field in dataclasses.fields(faulty)
        if getattr(faulty, field.name) != getattr(cured, field.name)
    ]
    assert len(differing) == 1, differing
    for run in (shown.faulty, shown.cured):
        value = getattr(run.profile, differing[0], None) or getattr(run.sim, differing[0], False)
        assert run.setting == f"{differing[0]}: {str(value).lower()}"
