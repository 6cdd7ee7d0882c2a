"""The formats that `station export` knows, by their registered names; what is heavy is imported when it is used."""

from __future__ import annotations

from adapters.exports import csv_tables, jointstate, named_rows, npz_arrays, parquet_tables
from adapters.exports.hdf5 import kind as hdf5
from adapters.exports.lerobot import kind as lerobot
from adapters.exports.lerobot.plan import VERSION
from adapters.exports.ros2 import kind as ros2
from adapters.exports.zarr import kind as zarr
from station.export.kind import ExportKind

LEROBOT = ExportKind(
    name="lerobot",
    summary="LeRobot data set, v3.0 or v2.1: rows on one clock, video per camera, statistics, GR00T's modality.json.",
    options=lerobot.LeRobotOptions,
    prepare=lerobot.prepare,
    convert=lerobot.convert,
    join=lerobot.join,
    columns=lerobot.columns,
    inspect=lerobot.inspect,
    reopen=lerobot.reopen,
    version=VERSION,
)
CSV = ExportKind(
    name="csv",
    summary="A table per key with named columns, for a spreadsheet or a quick plot.",
    options=named_rows.QuickLookOptions,
    prepare=named_rows.prepare,
    convert=csv_tables.convert,
    inspect=named_rows.inspect,
)
NPZ = ExportKind(
    name="npz",
    summary="Arrays, names and units of every key in one numpy file per episode, without pickle.",
    options=named_rows.QuickLookOptions,
    prepare=named_rows.prepare,
    convert=npz_arrays.convert,
    inspect=named_rows.inspect,
)
JOINTSTATE_MCAP = ExportKind(
    name="jointstate-mcap",
    summary="Joints as ROS 2 JointState in MCAP: Rerun draws them by name without any code.",
    options=named_rows.QuickLookOptions,
    prepare=named_rows.prepare,
    convert=jointstate.convert,
    inspect=jointstate.inspect,
    version=2,
)
PARQUET = ExportKind(
    name="parquet",
    summary="A table per key with named columns, units and times, for pandas, polars, duckdb; events and episodes too.",
    options=named_rows.QuickLookOptions,
    prepare=parquet_tables.prepare,
    convert=parquet_tables.convert,
    join=parquet_tables.join,
    inspect=named_rows.inspect,
)
ROS2 = ExportKind(
    name="ros2",
    summary="A ROS 2 bag (MCAP) per episode, of every write: for ros2 bag, rosbags, PlotJuggler, Foxglove.",
    options=ros2.BagOptions,
    prepare=ros2.prepare,
    convert=ros2.convert,
    inspect=ros2.inspect,
)
HDF5 = ExportKind(
    name="hdf5",
    summary="The rows of lerobot as HDF5: one file for robomimic, or a file per episode for ACT.",
    options=hdf5.Hdf5Options,
    prepare=hdf5.prepare,
    convert=hdf5.convert,
    join=hdf5.join,
    columns=hdf5.columns,
    inspect=hdf5.inspect,
)
ZARR = ExportKind(
    name="zarr",
    summary="The rows of lerobot as the Zarr replay buffer of diffusion_policy and UMI.",
    options=zarr.ZarrOptions,
    prepare=zarr.prepare,
    convert=zarr.convert,
    join=zarr.join,
    columns=zarr.columns,
    inspect=zarr.inspect,
)
