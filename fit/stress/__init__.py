"""`airlight stress`: stiff and extreme cases as tables; nothing here is used by a fit."""
