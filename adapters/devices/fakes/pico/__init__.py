"""A Pico headset that is not there: a PC service under the real ``xrobotoolkit-sdk``, playing a script.

``python -m adapters.devices.fakes.pico FILE`` runs one. A script is a JSON file, see ``example.json``; each number is
SI, in our frame (x forward, y left, z up; quaternions w x y z). All fields may be left out:

| field | what |
|---|---|
| ``device`` | ``pico``: guards against the wrong file |
| ``rate_hz`` | frames per second [Hz]; 72 |
| ``motion`` | a motion of the G1, as ``builtin:wave``: the person who does it, a controller in each hand |
| ``height_m`` | how tall that person is [m]; the robot's own size by default |
| ``repeat`` | ``once``: the last pose is held; ``swing``: forwards and backwards for ever |
| ``frames`` | in place of a motion: a list of what is where, see below |
| ``between`` | between two frames: ``blend``; ``hold`` plays a recording: each frame at its own time, as it is |
| ``origin`` | ``head``: where the head is at the start, as in the real app, heading included; ``floor``: as it is |
| ``controls`` | buttons, triggers and sticks, see below |
| ``faults`` | what goes wrong, see below |

**A frame** is ``{"at_s": 0.0, "head": [x, y, z, qw, qx, qy, qz], "left": …, "right": …, "body": {"positions": 24 x 3,
"quats_wxyz": 24 x 4}, "hands": {"left": 26 x 7, "right": …}, "controls": {"left_trigger": 0.5}}``. A pose that a frame
does not have stays as in the frame before it; a body, hands and controls are those of the newest frame.

**A control** is ``{"at_s": 1.0, "press": "right_primary", "for_s": 0.2}`` (0.2 by default), or ``{"at_s": 2.0, "set":
{"left_stick_y": 0.5}, "for_s": 3.0}`` (to the end by default); names are those of `station.operator.sample`.

**A fault** is ``{"at_s": 10.0, "kind": "silence", "for_s": 1.5}``; one second by default. Kinds:

| kind | what |
|---|---|
| ``silence`` | no frame comes |
| ``freeze`` | frames come, with one and the same time stamp |
| ``crash`` | the service dies, and is there again afterwards |
| ``jump`` | the world is moved ``by_m`` ([0.5, 0, 0]) and turned left by ``turn_deg`` (0); for ever by default |
| ``no-body``, ``no-controllers`` | that kind of tracking is off |
| ``torn`` | one frame lacks a field; the library drops it |
| ``poison`` | one frame holds a word in place of a number; the library aborts its process |

Time begins with the first client. What is played is a function of time alone, so two runs are alike, but for the
headset's time stamps, which are wall clock. Controllers and hands tremble by 10 micrometres, as held ones do, unless
they were recorded: what stands still to the last bit is taken for untracked (`adapters.devices.pico.headset`).
`recorded` makes a script of the samples of an episode.
"""
