"""Annotations of external assets: the file, a first proposal, and the session that edits one."""
