"""Collectives of a compiled program: their bytes, by hand, wherever they stand in it."""

import jax
import jax.numpy as jnp

from mesoshell.measure.collectives import Collective, collectives_of

TEXT = """HloModule jit_step, is_scheduled=true

%sum (a: f32[], b: f32[]) -> f32[] {
  ROOT %add = f32[] add(%a, %b)
}

%seldom (p: f32[8,4]) -> f32[8,4] {
  ROOT %all-reduce.1 = f32[8,4]{1,0} all-reduce(%p), channel_id=1, to_apply=%sum
}

%never (p: f32[8,4]) -> f32[8,4] {
  ROOT %copy = f32[8,4]{1,0} copy(%p)
}

%body (p: (s32[], bf16[16])) -> (s32[], bf16[16]) {
  %all-gather.2 = bf16[16]{0} all-gather(%x), channel_id=2, dimensions={0}
}

%orphan (p: f32[9]) -> f32[9] {
  ROOT %all-reduce.9 = f32[9]{0} all-reduce(%p), to_apply=%sum
}

ENTRY %main (p0: f32[3]) -> f32[3] {
  %all-reduce.3 = (f32[3]{0}, s32[2,2]{1,0}, f64[]) all-reduce(%p0, %p1, %p2), channel_id=3, to_apply=%sum
  %all-gather-start = (f32[1,8]{1,0}, f32[4,8]{1,0}) all-gather-start(%p3), channel_id=4, dimensions={0}
  %all-gather-done = f32[4,8]{1,0} all-gather-done(%all-gather-start)
  %conditional = f32[8,4]{1,0} conditional(%which, %q, %q), branch_computations={%never, %seldom}
  %while = (s32[], bf16[16]) while(%t), condition=%c, body=%body, backend_config={"known_trip_count":{"n":"5"}}
  ROOT %scatter = f32[3]{0} reduce-scatter(%p0), channel_id=5, to_apply=%sum
}
"""


def test_bytes_are_counted_by_hand_in_branches_and_loops() -> None:
    assert sorted(collectives_of(TEXT)) == sorted(
        [
            Collective("all-reduce", 12 + 16 + 8, 3, False, 1),
            Collective("all-gather", 128, 1, False, 1),
            Collective("all-reduce", 128, 1, True, 1),
            Collective("all-gather", 32, 1, False, 5),
            Collective("reduce-scatter", 12, 1, False, 1),
        ]
    )


def test_a_program_of_one_device_has_none() -> None:
    text = jax.jit(lambda x: jnp.sum(x @ x)).lower(jnp.ones((4, 4))).compile().as_text()
    assert text and collectives_of(text) == []
