"""The replay buffer of diffusion_policy and UMI: one Zarr group with the rows of all episodes one behind the other."""
