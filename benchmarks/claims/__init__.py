"""Judges known folds by the claim: the executive's own judgement of pictures of ideal and spoiled folds."""
