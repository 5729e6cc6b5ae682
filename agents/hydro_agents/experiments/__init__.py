"""Experiments on the true plant with a controller in the loop: frequency response, stiffness, standstill, costs."""
