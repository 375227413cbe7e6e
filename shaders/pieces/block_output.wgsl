
// Writes a quad of a layer's output, the kernel's binding y.
fn keep_output(at: u32, v: vec4f) {
#if texels
    textureStore(y, texel(at), v);
#else
    y[at] = StoredQuad(v);
#endif
}
