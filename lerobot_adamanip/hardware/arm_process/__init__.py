"""The arm's own process: `client` starts it, `program` and `server` run in it, `messages` and `mailbox` lie between.

The recorder and the arm share no interpreter: a renderer, an encoder or a hung recorder delays no tick of the arm, and
a recorder that is killed is answered by a planned stop. What drives the real arm, the twin and a fake is this one code.
"""
