"""Voices: how an operator hears cues (`station.operator.voice`)."""
