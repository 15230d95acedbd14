"""Why a pixel looks as it does."""
