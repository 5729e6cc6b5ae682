"""The parts of the axis, one file each: its parameters, coefficients, flows or forces, kinks and limits."""
