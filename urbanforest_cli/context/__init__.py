"""Context: neighbouring lots share their parameters."""
