"""Files of rows, models, tables and manifests: written as a whole, validated when read, with what made them."""
