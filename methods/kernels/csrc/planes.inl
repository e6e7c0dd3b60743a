// What is done with planes, one row a number and one lane a sample: networks and their gradients. After products.inl.

namespace {

static const float zeros[LANES] = {};

// out[i] = f(i) for i in steps of LANES below `count`.
template <class Function>
INLINE void each(int64_t count, float* out, Function f) {
  for (int64_t i = 0; i < count; i += LANES) store(out + i, f(i));
}
INLINE void copy(const float* from, int64_t count, float* to) {
  each(count, to, [=](int64_t i) { return load(from + i); });
}
INLINE void add(const float* from, int64_t count, float* to) {
  each(count, to, [=](int64_t i) { return load(to + i) + load(from + i); });
}
INLINE void clear(int64_t count, float* to) {
  each(count, to, [](int64_t) { return all(0); });
}

// One row of an array to or from a part of a longer row; null is left out.
INLINE void piece(const float* from, int64_t row, int64_t width, float*& to) {
  if (from) {
    if (width < 4)
      for (int64_t c = 0; c < width; ++c) to[c] = from[row * width + c];
    else __builtin_memcpy(to, from + row * width, (size_t)width * sizeof(float));
  }
  to += width;
}
INLINE void leave(const float*& from, int64_t row, int64_t width, float* to) {
  if (to) {
    if (width < 4)
      for (int64_t c = 0; c < width; ++c) to[row * width + c] = from[c];
    else __builtin_memcpy(to + row * width, from, (size_t)width * sizeof(float));
  }
  from += width;
}

// The rows [GROUP, stride] as planes [width, GROUP], and back; widths are rounded up to whole lanes.
INLINE void to_planes(const float* rows, int64_t stride, int width, float* planes) {
  for (int first = 0; first < GROUP; first += LANES)
    for (int c = 0; c < width; c += LANES)
      transpose(rows + first * stride + c, stride, planes + (int64_t)c * GROUP + first, GROUP);
}
INLINE void to_rows(const float* planes, int width, float* rows, int64_t stride) {
  for (int first = 0; first < GROUP; first += LANES)
    for (int c = 0; c < width; c += LANES)
      transpose(planes + (int64_t)c * GROUP + first, GROUP, rows + first * stride + c, stride);
}

// outputs[outputs, lanes] of a network; its hidden units are kept.
STAGE void evaluate(const SmallNetwork& n, const float* inputs, int lanes, float* hidden, float* outputs) {
  product({n.weight0, 1, n.hidden}, {inputs, lanes}, n.hidden, lanes, n.inputs, {n.bias0, 1, true}, hidden, lanes);
  each((int64_t)n.hidden * lanes, hidden, [=](int64_t i) { return maximum(all(0), load(hidden + i)); });
  product({n.weight1, 1, n.outputs}, {hidden, lanes}, n.outputs, lanes, n.hidden, {n.bias1, 1, true}, outputs, lanes);
}

// out[lane, row] of planes of `width` rows; rows of `out` are whole lanes, zero beyond the width.
STAGE void turn(const float* planes, int width, int lanes, float* out) {
  const int64_t stride = padded(width);
  for (int first = 0; first < lanes; first += LANES)
    for (int c = 0; c < width; c += LANES)
      transpose_rows([=](int r) { return c + r < width ? planes + (int64_t)(c + r) * lanes + first : zeros; },
                     out + first * stride + c, stride);
}

// Adds the products of the lanes of `left` [rows, lanes] and those of `right` [columns, lanes], and the sums of the
// latter, to weights and biases (null: not asked for).
STAGE void add_products(const float* left, int rows, const float* right, int columns, int lanes, float* turned,
                        float* weights, float* biases) {
  const int wide = (int)padded(columns);
  turn(right, columns, lanes, turned);
  product({left, lanes, 1}, {turned, wide}, rows, wide, lanes, {weights, wide}, weights, wide);
  if (biases) add_rows(turned, wide, lanes, wide, biases);
}

// From gradients by the outputs of a network: those by its weights are added to the sums (null: not asked for), those
// by its inputs to `by_inputs`. `by_hidden` and `turned` are scratch.
STAGE void pull(const SmallNetwork& n, const NetworkSums* sums, const float* inputs, const float* hidden,
                const float* by, int lanes, float* by_hidden, float* turned, float* by_inputs) {
  product({n.weight1, n.outputs, 1}, {by, lanes}, n.hidden, lanes, n.outputs, {nullptr, 0}, by_hidden, lanes);
  each((int64_t)n.hidden * lanes, by_hidden,
       [=](int64_t i) { return keep(load(hidden + i) > all(0), load(by_hidden + i)); });
  if (sums) {
    add_products(hidden, n.hidden, by, n.outputs, lanes, turned, sums->weight1, sums->bias1);
    add_products(inputs, n.inputs, by_hidden, n.hidden, lanes, turned, sums->weight0, sums->bias0);
  }
  product({n.weight0, n.hidden, 1}, {by_hidden, lanes}, n.inputs, lanes, n.hidden, {by_inputs, lanes}, by_inputs, lanes);
}

}  // namespace
