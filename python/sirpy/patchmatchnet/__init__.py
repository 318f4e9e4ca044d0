"""PatchmatchNet in torch, from its publication: whole images as published, and windows of images of any size."""

from sirpy.patchmatchnet.network import PatchmatchNet, Result

__all__ = ["PatchmatchNet", "Result"]
