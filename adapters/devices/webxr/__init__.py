"""Any headset, or a phone, as an operator's device: a page that its browser opens, by WebXR where it has that.

`kind` says what there is to set, `pages` serves the page, `frame` is what comes back 72 or 90 times a second, `body`
the part of it that is a person, `headset` judges it: whose it is, how old, and whether the operator has let go.
"""
