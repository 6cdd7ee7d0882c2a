"""Kassow arms."""
