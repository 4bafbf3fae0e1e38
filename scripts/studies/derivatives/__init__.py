"""Uses of derivatives through impacts: docs/derivatives.md."""
