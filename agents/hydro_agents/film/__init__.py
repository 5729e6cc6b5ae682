"""Films of axes under controllers."""
