"""From recordings to physically consistent parameters: signals ← equations ← estimators ← consistent ← confidence ← pipeline."""
