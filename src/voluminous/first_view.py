"""From where a first picture is taken: obliquely above, in degrees."""

FIRST_INCL, FIRST_PHI = 60.0, 30.0
