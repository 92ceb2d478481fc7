"""Files of VTK and its objects, read by VTK itself."""
