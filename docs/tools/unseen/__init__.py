"""Unseen sequences: generators that share nothing with the built-in scenes. `docs/tools/make_unseen.py` runs them."""
