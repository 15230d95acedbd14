/* Procedural textures of the built-in scenes, filtered analytically: `fp` is the width of a pixel on the surface, in
   meters; finer detail fades to its mean. */

enum {
    PLAIN,
    TILES,
    CHECKER,
    BRICKS,
    PLANKS,
    MARBLE,
    CARPET,
    STRIPES,
    BARK,
    LEAVES,
    GRASS,
    BOOKS,
    PICTURE,
    SIGN,
    WALLPAPER,
    COBBLES,
    WATER
};

INLINE uint hash_bits(uint x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}

INLINE float hash_cell(const int x, const int y, const int z) {
    return (float)(hash_bits((uint)x * 0x9e3779b1u ^ hash_bits((uint)y * 0x85ebca77u ^ hash_bits((uint)z))) >> 8)
           * (1.0f / 16777216.0f);
}

INLINE float value_noise(const float3 p) {
    const float3 base = floor(p);
    const float3 f = p - base;
    const float3 s = f * f * (3.0f - 2.0f * f);
    const int3 c = convert_int3(base);
    float corner[8];
    for (int k = 0; k < 8; ++k) corner[k] = hash_cell(c.x + (k & 1), c.y + ((k >> 1) & 1), c.z + (k >> 2));
    const float4 x = (float4)(mix(corner[0], corner[1], s.x), mix(corner[2], corner[3], s.x),
                              mix(corner[4], corner[5], s.x), mix(corner[6], corner[7], s.x));
    return mix(mix(x.x, x.y, s.y), mix(x.z, x.w, s.y), s.z);
}

/* Mean 0.5, about [0.1, 0.9]; `fp` in the units of p. */
INLINE float fbm(float3 p, float fp, const int octaves) {
    float sum = 0.0f, weight = 0.5f;
    for (int k = 0; k < octaves && fp < 0.7f; ++k) {
        sum += weight * (value_noise(p) - 0.5f) * (1.0f - smoothstep(0.3f, 0.7f, fp));
        p = 2.03f * p + (float3)(17.1f, 9.2f, 5.7f);
        fp *= 2.03f;
        weight *= 0.55f;
    }
    return 0.5f + 1.1f * sum;
}

/* 1 on lines of half-width `half_width` at the integers, 0 between. */
INLINE float lines(const float x, const float half_width, const float fp) {
    const float edge = 0.5f - fabs(x - floor(x) - 0.5f);
    const float soft = max(0.6f * fp, 1e-4f);
    const float line = 1.0f - smoothstep(half_width - soft, half_width + soft, edge);
    return mix(line, 2.0f * half_width, smoothstep(0.4f, 1.0f, fp));
}

/* Square wave of period 2: +1 on even cells, -1 on odd ones. */
INLINE float square_wave(const float x, const float fp) {
    const float half_x = 0.5f * (x - 0.5f);
    const float tent = fabs(half_x - floor(half_x) - 0.5f) * 2.0f;  /* 1 amid even cells, 0 amid odd ones */
    return clamp((tent - 0.5f) * 2.0f / max(fp, 1e-4f), -1.0f, 1.0f) * (1.0f - smoothstep(0.6f, 1.4f, fp));
}

INLINE float disc(const float2 p, const float radius, const float fp) {
    return 1.0f - smoothstep(radius - fp, radius + fp, length(p));
}

/* 0 where a pixel holds more than one cell, 1 where cells are resolved. */
INLINE float resolved(const float fp) { return 1.0f - smoothstep(0.4f, 1.2f, fp); }

INLINE float3 palette(const float h) { return 0.5f + 0.5f * cos(6.2832f * (h + (float3)(0.0f, 0.33f, 0.67f))); }

/* Albedo of a material at local point p with local normal n. `center` and `extent` are those of the primitive. */
INLINE float3 texture_color(__global const float4 *material, const float3 p, const float3 n, const float3 center,
                            const float3 extent, const float fp_meters) {
    const int texture = (int)material[0].w;
    const float3 color = material[0].xyz, color2 = material[1].xyz, seed = material[4].xyz;
    const float scale = material[1].w, contrast = material[3].w;
    const float3 a = fabs(n);
    const float3 framed = texture == PICTURE || texture == SIGN || texture == CARPET ? p - center : p;
    const float2 uv = a.y > a.x && a.y > a.z ? framed.xz : a.x > a.z ? framed.zy : framed.xy;
    const float2 uv_extent = a.y > a.x && a.y > a.z ? extent.xz : a.x > a.z ? extent.zy : extent.xy;
    const float fp = fp_meters / scale;
    const float2 q = uv / scale;
    const int salt = (int)(seed.x * 8.0f);

    /* One noise for every texture, stretched to suit it. */
    float3 noise_p = p / scale;
    float noise_fp = fp;
    if (texture == PLANKS) {
        const bool along_z = a.x > max(a.y, a.z);
        noise_p *= (float3)(along_z ? 9.0f : 0.7f, 9.0f, along_z ? 0.7f : 9.0f);
        noise_fp *= 9.0f;
    }
    if (texture == BARK) noise_p *= (float3)(3.0f, 0.5f, 3.0f), noise_fp *= 3.0f;
    if (texture == BRICKS || texture == TILES || texture == COBBLES) noise_p *= 4.0f, noise_fp *= 4.0f;
    if (texture == LEAVES) noise_p *= 2.0f, noise_fp *= 2.0f;
    if (texture == CARPET || texture == WALLPAPER || texture == STRIPES) noise_p *= 6.0f, noise_fp *= 6.0f;
    const float noise = fbm(noise_p + seed, noise_fp, 5);
    const float tone = 1.0f + contrast * 2.0f * (noise - 0.5f);

    if (texture == PLAIN) return color * tone;
    if (texture == TILES) {
        const float grout = max(lines(q.x, 0.018f, fp), lines(q.y, 0.018f, fp));
        const float h = hash_cell((int)floor(q.x), (int)floor(q.y), salt) - 0.5f;
        return mix(color * (tone + 0.22f * h * resolved(fp)), color2, grout);
    }
    if (texture == CHECKER) {
        const float wave = square_wave(q.x, fp) * square_wave(q.y, fp);
        const float grout = max(lines(q.x, 0.008f, fp), lines(q.y, 0.008f, fp));
        return mix(color2, color, 0.5f + 0.5f * wave) * tone * (1.0f - 0.5f * grout);
    }
    if (texture == BRICKS || texture == COBBLES) {
        const float aspect = texture == BRICKS ? 2.8f : 1.15f;
        const float row = floor(q.y);
        const float shift = 0.5f * row + (texture == COBBLES ? 0.35f * hash_cell((int)row, 3, salt) : 0.0f);
        const float x = q.x / aspect + shift;
        const float width = texture == BRICKS ? 0.06f : 0.085f;
        float joint = max(lines(x, width / aspect, fp / aspect), lines(q.y, width, fp));
        if (texture == COBBLES) {
            const float2 corner = (float2)(x - floor(x) - 0.5f, q.y - row - 0.5f) * 2.0f;
            const float round = pow(corner.x * corner.x, 3.0f) + pow(corner.y * corner.y, 3.0f);
            joint = max(joint, smoothstep(0.55f, 0.8f, round) * resolved(fp * 2.0f));
        }
        const float h = hash_cell((int)floor(x), (int)row, salt) - 0.5f;
        return mix(color * (tone + 0.55f * h * resolved(fp)), color2 * (0.8f + 0.4f * noise), joint);
    }
    if (texture == PLANKS) {
        const float row = floor(q.y);
        const float x = q.x * 0.13f + hash_cell((int)row, 7, salt);
        const float joint = max(lines(q.y, 0.016f, fp), lines(x, 0.0022f, fp * 0.13f));
        const float h = hash_cell((int)floor(x), (int)row, salt) - 0.5f;
        return mix(mix(color, color2, clamp(0.5f + contrast * 4.0f * (noise - 0.5f), 0.0f, 1.0f))
                       * (1.0f + 0.4f * h * resolved(fp)),
                   color * 0.25f, joint);
    }
    if (texture == MARBLE) {
        const float vein = 0.5f + 0.5f * sin((p.x + 0.6f * p.z + 0.8f * p.y) / scale * 2.0f + 9.0f * noise + seed.y);
        return mix(color2, color, 1.0f - contrast * pow(vein, 6.0f) * resolved(2.0f * fp)) * (0.85f + 0.3f * noise);
    }
    if (texture == CARPET) {
        const float2 edge = (uv_extent - fabs(uv)) / scale;
        const float border = min(edge.x, edge.y);
        const float2 w = q * 3.14159f;
        const float ornament = sin(w.x * 2.0f) * sin(w.y * 2.0f) + 0.6f * cos(w.x * 4.0f) * cos(w.y * 4.0f);
        const float figure = smoothstep(-0.05f - fp * 4.0f, 0.05f + fp * 4.0f, ornament - 0.25f) * resolved(2.0f * fp);
        float3 c = mix(color, color2, figure);
        const float band = smoothstep(0.9f + fp, 0.9f - fp, border);
        const float stripe = lines(border * 2.2f, 0.14f, fp * 2.2f);
        c = mix(c, mix(color2, color * 0.45f, stripe), band);
        return c * tone * (1.0f - 0.25f * lines(q.x * 12.0f, 0.2f, fp * 12.0f));
    }
    if (texture == STRIPES) return mix(color2, color, 0.5f + 0.5f * square_wave(p.y / scale, fp)) * tone;
    if (texture == BARK) return mix(color2, color, smoothstep(0.35f, 0.6f, noise)) * (0.75f + 0.5f * noise);
    if (texture == LEAVES || texture == GRASS) {
        const bool leaves = texture == LEAVES;
        float3 c = mix(color2, color, leaves ? smoothstep(0.32f, 0.68f, noise) : smoothstep(0.2f, 0.75f, noise));
        if (leaves) c *= mix(1.0f, 0.45f + 1.1f * value_noise(p * 24.0f), resolved(fp_meters * 30.0f));
        if (texture == GRASS) {
            const float patch = value_noise(p * 0.35f + seed);
            const float blades =
                mix(1.0f, 0.55f + 0.9f * value_noise(p * (float3)(70.0f, 1.0f, 70.0f)), resolved(fp_meters * 90.0f));
            const float fallen =
                smoothstep(0.66f, 0.72f, value_noise(p * 19.0f + seed.yzx)) * resolved(fp_meters * 22.0f);
            c = mix(c, c * (float3)(1.25f, 1.0f, 0.7f), patch) * ((0.75f + 0.5f * patch) * blades);
            c = mix(c, (float3)(0.36f, 0.2f, 0.07f) * (0.5f + noise), mix(0.12f, 1.0f, fallen) * contrast);
        }
        return c * (0.7f + 0.6f * noise);
    }
    if (texture == BOOKS) {
        const float row = floor(q.y), y = q.y - row;
        const float x = q.x * 9.0f + 3.0f * hash_cell((int)row, 1, salt);
        const float h = hash_cell((int)floor(x), (int)row, salt);
        const float top = 0.62f + 0.3f * hash_cell((int)floor(x), (int)row, salt + 1);
        const float gap = max(lines(x, 0.05f, 9.0f * fp), smoothstep(top - fp, top + fp, y));
        const float title = lines(y * 2.0f + 0.1f + 0.3f * h, 0.09f, 2.0f * fp) * resolved(9.0f * fp);
        const float3 spine = mix(color, palette(h) * (0.25f + 0.5f * h), 0.65f) * (0.7f + 0.6f * noise);
        return mix(mix(mix(color, color2, 0.3f) * 0.5f, mix(spine, color2, 0.6f * title), resolved(6.0f * fp)),
                   (float3)(0.03f, 0.02f, 0.015f), gap);
    }
    if (texture == PICTURE || texture == SIGN) {
        const float2 edge = uv_extent - fabs(uv);
        const float margin = min(edge.x, edge.y), soft = fp_meters;
        float3 c = color;
        if (texture == PICTURE) {
            c = mix(color, color2, smoothstep(-0.5f, 0.5f, uv.y / uv_extent.y + 0.8f * (noise - 0.5f)));
            for (int k = 0; k < 5; ++k) {
                const float h = hash_cell(k, salt, 5), g = hash_cell(k, salt, 6), r = hash_cell(k, salt, 7);
                const float2 middle = ((float2)(h, g) - 0.5f) * 1.5f * uv_extent;
                const float blob = disc(uv - middle, (0.1f + 0.35f * r) * min(uv_extent.x, uv_extent.y), soft);
                c = mix(c, palette(h + g + 0.3f) * (0.2f + 0.7f * r), blob * 0.85f);
            }
            c *= 0.75f + 0.5f * noise;
        } else {
            const float2 cell = uv / scale;
            const float row = floor(cell.y), y = cell.y - row;
            const float x = cell.x * 1.6f;
            const float ink = hash_cell((int)floor(x * 4.0f), (int)floor(y * 5.0f), (int)row * 57 + salt);
            const float letter = step(0.45f, ink) * smoothstep(0.2f, 0.2f + 3.0f * fp, y)
                                 * (1.0f - smoothstep(0.85f - 3.0f * fp, 0.85f, y)) * step(0.12f, x - floor(x));
            const float word = step(0.18f, hash_cell((int)floor(x / 3.0f), (int)row, salt));
            c = mix(color, color2, mix(0.35f, letter, resolved(5.0f * fp)) * word * step(2.2f * scale * 0.2f, margin));
        }
        const float rim = 0.06f * min(uv_extent.x, uv_extent.y);
        return mix(c, color2 * 0.4f, 1.0f - smoothstep(rim - soft, rim + soft, margin));
    }
    if (texture == WALLPAPER) {
        const float2 w = q * 6.2832f;
        const float vine =
            sin(w.x + 0.8f * sin(0.5f * w.y)) * sin(0.5f * w.y) + 0.5f * sin(2.0f * w.x) * sin(1.5f * w.y);
        const float figure = smoothstep(-0.08f - 4.0f * fp, 0.08f + 4.0f * fp, vine - 0.3f);
        return mix(color, color2, mix(0.3f, figure, resolved(2.0f * fp))) * tone;
    }
    return mix(color, color2, smoothstep(0.3f, 0.7f, noise));  /* WATER */
}
