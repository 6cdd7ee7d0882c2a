"""Fixtures of the views."""

from tests.view.pictures import drawing_machine

__all__ = ["drawing_machine"]
