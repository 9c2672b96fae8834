"""The arm's own process: `client` starts it, `__main__` and `server` run in it.

No renderer, encoder or hung recorder delays a tick of the arm, and a killed recorder is answered by a planned stop.
"""
