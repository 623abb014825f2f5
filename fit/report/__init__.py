"""What people and other programs read: all of it made from fit.json's document."""
