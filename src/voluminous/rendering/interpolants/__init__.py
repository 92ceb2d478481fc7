"""Fields between the points where they are known, as rays gather them."""
