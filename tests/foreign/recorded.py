"""Folders as TWIST2's recorder writes them."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

from PIL import Image

STARTED_MS = 1_763_700_000_000
PERIOD_MS = 33


def jpeg(number: int) -> bytes:
    """A picture whose shade says which one it is."""
    file = io.BytesIO()
    picture = Image.new("RGB", (64, 18), (number * 7 % 256, 128, 30))
    picture.paste((20, 40, 90), (0, 0, 32, 18))
    picture.save(file, "JPEG", quality=95)
    return file.getvalue()


def entry(number: int, *, started_ms: int = STARTED_MS) -> dict[str, Any]:
    """What the stock recorder writes at a tick."""
    t_ms = started_ms + number * PERIOD_MS
    return {
        "idx": number,
        "rgb": f"rgb/{number:06d}.jpg",
        "t_img": t_ms,
        "state_body": [0.1 * number, 1e-05, *[0.0] * 32],
        "state_hand_left": [0.0] * 7,
        "state_hand_right": [0.0] * 7,
        "state_neck": [0, 0],
        "t_state": t_ms - 5,
        "action_body": [0.01 * number, *[0.5] * 34],
        "action_hand_left": [0.0] * 7,
        "action_hand_right": [0.0] * 7,
        "action_neck": [0.0, 0.0],
        "t_action": t_ms - 8,
    }


def document(entries: int = 5, *, started_ms: int = STARTED_MS) -> dict[str, Any]:
    """A whole ``data.json``; of its picture, width and height are swapped, as upstream."""
    return {
        "info": {
            "version": "1.0.0", "date": "2025-11-21", "author": "ada",
            "image": {"width": 360, "height": 1280, "fps": 30},
        },
        "text": {"goal": "pick up the cup", "desc": "d", "steps": "s"},
        "data": [entry(number, started_ms=started_ms) for number in range(entries)],
    }  # fmt: skip


def record(folder: Path, found: Any = None, *, pictures: int | None = None) -> Path:
    """Write a recording's folder; what it is not told of is as the stock recorder has it."""
    found = document() if found is None else found
    (folder / "rgb").mkdir(parents=True)
    for number in range(len(found["data"]) if pictures is None else pictures):
        (folder / f"rgb/{number:06d}.jpg").write_bytes(jpeg(number))
    (folder / "data.json").write_text(json.dumps(found, indent=4))
    return folder
