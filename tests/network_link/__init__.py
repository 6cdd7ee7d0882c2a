"""Two computers on one machine and the cable between them: see `tests.network_link.link`."""
