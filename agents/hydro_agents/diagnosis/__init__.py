"""From a recording to a verdict: healthy, internal leak, something else, or cannot tell."""
