"""What stands in the manifest of an episode: its JSON schema, made from the types, and an example."""
