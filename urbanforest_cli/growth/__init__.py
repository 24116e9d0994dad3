"""Growth: every plant as a skeleton, grown in its own place."""
