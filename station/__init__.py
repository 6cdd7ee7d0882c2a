"""Teleop Station: what every process of a station shares."""

import os

# ONNX Runtime 1.32 sends usage data to its maker, from a thread beside the control loop. It reads this when imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
