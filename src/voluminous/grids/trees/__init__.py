"""Cells of different sizes in a tree of nodes: octrees and nested patches."""
