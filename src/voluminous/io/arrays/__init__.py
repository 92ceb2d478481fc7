"""Files that are a set of named arrays on a Cartesian grid."""
