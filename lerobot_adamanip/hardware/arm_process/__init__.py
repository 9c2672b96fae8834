"""The arm process: `client` starts it; `__main__` and `server` run in it.

A renderer, an encoder or a hung recorder cannot delay a tick of the arm. A killed recorder causes a controlled stop.
"""
