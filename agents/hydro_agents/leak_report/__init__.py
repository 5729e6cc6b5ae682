"""The page of the leakage protocol: smallest detectable leak, delay, reliability, and windows without an answer."""
