"""Files of rows, models, tables and manifests: written atomically and validated when read."""
