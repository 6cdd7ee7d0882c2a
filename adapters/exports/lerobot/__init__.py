"""LeRobot data sets, layouts v3.0 and v2.1, written with pyarrow and PyAV alone; read by LeRobot, GR00T, openpi."""
