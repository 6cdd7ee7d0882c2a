"""Collections of files: what is built in, and what upstream projects offer, pinned by revision, size and hash."""
