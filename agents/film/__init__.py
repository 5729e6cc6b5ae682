"""Moving pictures of axes under controllers."""
