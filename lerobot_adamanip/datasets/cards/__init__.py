"""Dataset cards for the Hub."""
