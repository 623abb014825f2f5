"""Photos: from a file to linear light, the pixels that count, and the photo taken again."""
