"""What an episode is on disk: names, records, the manifest, the folder it lives in."""
