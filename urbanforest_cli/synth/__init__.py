"""A procedural city: streets, blocks, lots, buildings and what stands between them."""
