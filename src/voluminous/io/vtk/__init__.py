"""Files of VTK, and its objects: image data and rectilinear grids.

Our own parsers read the files: VTK itself is large, and a damaged file must not bring it down.
"""
