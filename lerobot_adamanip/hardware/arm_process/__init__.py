"""The arm process: `client` starts `server`, and `mailbox` connects them.

A renderer, an encoder or a hung recorder cannot delay a tick of the arm. A killed recorder causes a controlled stop.
"""
