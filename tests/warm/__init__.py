"""Children that start warm: forked from a process that has numpy, MuJoCo, ONNX Runtime and the station imported."""
