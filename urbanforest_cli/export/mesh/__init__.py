"""From skeletons to triangles: wood, leaves, textures, and coarser versions of all."""
