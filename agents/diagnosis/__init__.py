"""From a recording to a verdict: healthy, an internal leak, something else, or cannot tell."""
