"""A page that is not there: a socket of its own that sends what a script says, as a headset's browser does.

Its scripts are those of the fake Pico headset (`adapters.devices.fakes.pico`), with ``"device": "webxr"``. A ``crash``
is a tab that was killed, ``torn`` a message that was cut, ``poison`` a pose that is no number. The control
``touch_hold`` is a finger on the pad of a phone that drives; with frames that have a hand and no head the phone is
itself that hand.
"""
