"""A policy's runtime sends nothing to its maker, and has no thread for it beside the control loop."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

LOAD = "import os, station, adapters.policies.onnx_network; print(len(os.listdir('/proc/self/task')))"


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted as Linux lists them")
def test_the_runtime_of_a_policy_starts_no_thread_of_its_own_when_it_is_imported(processes: None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    one_thread = environment | {"OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-B", "-c", LOAD]  # cold: what an import starts is asked for
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=one_thread)
    assert done.stdout == "1\n"
