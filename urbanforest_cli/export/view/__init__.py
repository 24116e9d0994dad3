"""Pictures of whole cities, drawn without a graphics card."""
