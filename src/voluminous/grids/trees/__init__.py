"""Cells of different sizes in a tree of blocks: octrees and nested patches."""
