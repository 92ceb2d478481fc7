"""A medium put before a volume: coefficients per cell, per vertex, or on the ray."""
