"""Unseen sequences: generators that share nothing with the built-in scenes. `docs/unseen/make_unseen.py` runs them."""
