"""Neural texture mapping: objects from photographs, with a texture that can be edited (Xiang et al., NeuTex, CVPR 2021)."""
