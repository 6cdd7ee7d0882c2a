"""A fake Motive: a NatNet server on a UDP port, with one actor who follows a script.

A script is a JSON file, see ``example.json``: ``{"device": "natnet", "steps": [{"at_s": 0.0, …}], "period_s": 60.0}``.
A step says ``motion``, one of the G1 as ``builtin:wave``, which the actor does from then on, forwards and backwards;
before the first one the actor stands. Or ``fault``, what is wrong from then on, until another step says ``""``:

| fault | what |
|---|---|
| ``silence`` | no frame comes |
| ``freeze`` | frames come, all of one time |
| ``still`` | times go on, the bones do not |
| ``untracked`` | bones stay where they were, and are said not to be tracked |
| ``no-actor`` | frames without the actor |
| ``cut`` | half of each frame |
| ``too-many`` | frames that announce a million bones |

The actor trembles by 10 micrometres, as all that is tracked does.
"""
