"""Files that the station uses and may not carry: found by reference, fetched by name.

A reference is a plain path, or ``collection:relative/path``, for example ``twist2:motions/0807_yanjie_walk_001.pkl``.
The latter is looked for in ``$STATION_ASSETS/collection/``, then in the user's cache, then among what is built in.
Which collections there are, what is built in and what can be fetched, say the objects that are registered as
``station.assets``.
"""

from station.assets.collection import Bundle, Collection, PinnedFile, Upstream, read_collection, sha256
from station.assets.places import (
    ENVIRONMENT_VARIABLE,
    FoundFile,
    cache,
    expand,
    find,
    is_reference,
    references,
    resolve,
    root,
)

__all__ = [
    "ENVIRONMENT_VARIABLE", "Bundle", "Collection", "FoundFile", "PinnedFile", "Upstream",
    "cache", "expand", "find", "is_reference", "read_collection", "references", "resolve", "root", "sha256",
]  # fmt: skip
