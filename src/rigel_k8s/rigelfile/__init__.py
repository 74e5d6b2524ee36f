"""Rigelfiles: text with places, templates, the model, and structuring into option classes."""
