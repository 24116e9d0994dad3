"""Folders of images with their truth, read as pairs."""
