"""Sources of coefficients for schemes: a table, cells on the ray, or interpolated fields."""
