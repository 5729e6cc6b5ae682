"""Contrast of colours, by the rules of WCAG 2: 3 suffices for lines, 4.5 for text."""

import numpy as np


def mixed(colour, background, percent):
    """The colour mixed with a background, like ``color-mix`` of CSS in sRGB."""
    pairs = zip(_channels(colour), _channels(background), strict=True)
    return "#" + "".join(f"{round(b + percent / 100.0 * (a - b)):02x}" for a, b in pairs)


def contrast(first, second):
    """Contrast ratio of two colours."""
    lighter, darker = sorted((_luminance(first), _luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def _channels(colour):
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _luminance(colour):
    parts = [part / 255.0 for part in _channels(colour)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))
