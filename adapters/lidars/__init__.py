"""Sources of point clouds: one module per kind, all of them `station.lidar.source.Lidar`."""
