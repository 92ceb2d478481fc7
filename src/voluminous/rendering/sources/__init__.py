"""Where a scheme gets its coefficients from: tables, cells on the ray, or interpolated fields."""
