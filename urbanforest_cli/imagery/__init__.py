"""Stage: from an aerial image to a map of vegetation coverage."""
