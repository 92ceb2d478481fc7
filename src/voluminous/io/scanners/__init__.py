"""Voxels from scanners and microscopes: NRRD, NIfTI, MetaImage, DICOM and stacks of pictures."""
