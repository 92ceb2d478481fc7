"""Derivatives of fields: what ``gradmag``, ``laplacian`` and ``grad`` in expressions stand for."""

from .fields import Derivatives

__all__ = ["Derivatives"]
