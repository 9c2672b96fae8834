"""Python imports this first where its folder is on PYTHONPATH: so in a process of a test, and in all that it starts."""

import loopback_guard

loopback_guard.install()
