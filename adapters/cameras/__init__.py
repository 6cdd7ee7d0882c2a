"""Sources of pictures: one module per kind, all of them `station.camera.source.Camera`."""
