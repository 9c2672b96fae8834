"""Is a recorded dataset what it says it is? Findings by kind, file, episode and frame; and mending what a kill left."""
