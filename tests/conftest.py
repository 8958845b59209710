"""Test set-up: shapes are checked with beartype, ranks and dtypes must match exactly, warnings are errors."""

from jaxtyping import install_import_hook

install_import_hook("mesoshell", "beartype.beartype")

import jax  # noqa: E402  (the hook must come first)

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
