#version 330 core
/* All that the canvas shows, chosen by uniforms. y goes down: row 0 of a layer is the top of the picture, and so is the
   first row of what is drawn. Layers are addressed by uv, fractions of the display. Colors are display values unless
   called linear.

   What the canvas shows is chosen by macros, because llvmpipe runs both sides of every branch. Of each layer: VIEW
   (-1: no such layer), SMOOTH (1: drawn smaller, with mipmaps), CHANNEL (-1: all), TONE_MAP, WEIGHTED (1: color is a
   sum, its weight the fourth channel), WHOLE (1: it covers the display and no more); and COMPARE, OVERLAY, GRID (1:
   there are lines between pixels). All else is uniforms. */

/* COLOR, TONE_ACES, MAP_HEAT, DIFFERENCE, SIGNED, CLIPPING and so on are the places in VIEWS (layers.py), TONE_MAPS and COLOR_MAPS
   (displays.py), COMPARISONS, OVERLAYS and DIFFERENCES (view.py): canvas.py defines them. */

struct Layer {
    int components, plane;
    float unit;           /* values per texel value: 255 for bytes */
    vec4 area, own;       /* see FrameInfo.area, FrameInfo.own_place */
    vec2 texel;           /* screen pixels per texel */
    float level;          /* of mipmaps */
    float gain;           /* of linear color */
    int color_map;
    vec2 range;
    bool inverse;
    float motion_scale;   /* negative: reversed */
    vec3 tint;
    int label_flip;       /* 15: the usual label is 15, not 0 */
};

uniform Layer layer[2];
uniform sampler2DArray texels_a, texels_b, rendered_depth;
uniform sampler2D color_maps;   /* a row each */

uniform vec2 corner, size;      /* of what is drawn, in the framebuffer */
uniform vec2 center;            /* of what is drawn, a fraction of the display */
uniform vec2 step;              /* fraction of the display per pixel */
uniform bool bottom_up;         /* the first row of the framebuffer is the bottom one, as in windows */
uniform vec3 background;
uniform float grid_contrast;
uniform int difference;         /* ABSOLUTE, SIGNED, RELATIVE or MEAN */
uniform float difference_high;

uniform bool has_depth, has_source;
uniform vec4 source_inverse;    /* 1/fx, 1/fy, cx, cy of the rendered camera */

out vec4 pixel;

/* isnan and isinf may be optimized away. */
bool is_nan(const float v) { return (floatBitsToUint(v) & 0x7fffffffu) > 0x7f800000u; }
bool is_bad(const float v) { return (floatBitsToUint(v) & 0x7fffffffu) >= 0x7f800000u; }
bool is_bad(const vec3 v) {
    uvec3 size = floatBitsToUint(v) & 0x7fffffffu;
    return max(size.x, max(size.y, size.z)) >= 0x7f800000u;
}
bool is_sky(const float z) { return floatBitsToUint(z) == 0x7f800000u; }
bool inside(const vec2 uv) { return uv.x >= 0.0 && uv.y >= 0.0 && uv.x < 1.0 && uv.y < 1.0; }

/* NaN or infinite. */
vec3 checker() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    return ((at.x ^ at.y) & 4) == 0 ? vec3(1.0, 0.0, 1.0) : vec3(0.05);
}

/* Nothing is known here. */
vec3 hatch() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    return vec3(((at.x + at.y) & 7) < 2 ? 0.30 : 0.12);
}

ivec2 texel_at(const vec2 uv, const ivec2 texels) {
    return min(ivec2(uv * vec2(texels)), texels - 1);
}

/* The layer's number is a constant wherever these are called. */
int view_of(const int i) { return i == 0 ? VIEW_A : VIEW_B; }
int channel_of(const int i) { return i == 0 ? CHANNEL_A : CHANNEL_B; }
int tone_map_of(const int i) { return i == 0 ? TONE_MAP_A : TONE_MAP_B; }
bool is_weighted(const int i) { return (i == 0 ? WEIGHTED_A : WEIGHTED_B) == 1; }
bool is_whole(const int i) { return (i == 0 ? WHOLE_A : WHOLE_B) == 1; }

vec4 load_from(sampler2DArray texels, const Layer l, const bool smooth_it, const vec2 uv) {
    if (smooth_it) return l.unit * textureLod(texels, vec3(uv, float(l.plane)), l.level);
    return l.unit * texelFetch(texels, ivec3(texel_at(uv, textureSize(texels, 0).xy), l.plane), 0);
}

vec4 load(const int i, const vec2 uv) {
    return i == 0 ? load_from(texels_a, layer[0], SMOOTH_A == 1, uv) : load_from(texels_b, layer[1], SMOOTH_B == 1, uv);
}

vec2 size_of(const int i) { return vec2(i == 0 ? textureSize(texels_a, 0).xy : textureSize(texels_b, 0).xy); }

vec2 uv_of(const int i, const vec2 uv) { return is_whole(i) ? uv : mix(layer[i].area.xy, layer[i].area.zw, uv); }

bool covers(const int i, const vec2 uv) { return view_of(i) >= 0 && (is_whole(i) || inside(uv_of(i, uv))); }

/* 1.055 c^(1/2.4) - 0.055 above the linear foot, within 1.1e-4: two roots cost llvmpipe half of what a power does. */
vec3 srgb(const vec3 linear) {
    vec3 c = clamp(linear, 0.0, 1.0), root = sqrt(c), fourth = sqrt(root);
    vec3 power = 0.9126921 * root + 0.2545009 * fourth + (0.0356445 * root - 0.1322247) * c - 0.0705122;
    return mix(power, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

vec3 tone_mapped(const vec3 linear, const int tone_map) {
    vec3 c = max(linear, 0.0);
    if (tone_map == TONE_LINEAR) return min(c, 1.0);
    if (tone_map == TONE_REINHARD) c = c / (1.0 + c);
    if (tone_map == TONE_ACES) c = (c * (2.51 * c + 0.03)) / (c * (2.43 * c + 0.59) + 0.14);  /* K. Narkowicz's fit */
    return srgb(c);
}

vec3 mapped(const float t, const int color_map) {
    vec2 at = vec2(clamp(t, 0.0, 1.0) * 255.0, float(color_map)) + 0.5;
    return textureLod(color_maps, at / vec2(256.0, float(MAPS)), 0.0).rgb;
}

vec3 hue_of(const vec2 v) {
    float turns = v == vec2(0.0) ? 0.0 : atan(v.y, v.x) / 6.28318530718;
    return clamp(abs(mod(turns * 6.0 + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
}

float share_of(const vec2 v, const float scale) { return sqrt(min(length(v) / scale, 1.0)); }

vec3 wheel(const vec2 v, const float scale) {
    return mix(WHEEL_CENTER, hue_of(v * sign(scale)), share_of(v, abs(scale)));
}

float ramp_position(const int view, const Layer l, const float v) {
    if (view == DEPTH && l.inverse) {
        float low = max(l.range.x, 1e-6), high = max(l.range.y, 2e-6);
        return (1.0 / v - 1.0 / low) / (1.0 / high - 1.0 / low);
    }
    return (v - l.range.x) / (l.range.y - l.range.x);
}

vec3 unproject(const vec2 px, const float z, const vec4 inverse) {
    return vec3((px - inverse.zw) * inverse.xy, 1.0) * z;
}

/* Value of layer i as a vector: its one value, or the vector that is shown, in xyz; w = 0 where there is none. */
vec4 vector_of(const int i, const vec2 layer_uv, const vec4 v) {
    Layer l = layer[i];
    if (view_of(i) == MOTION) return vec4(v.xy, 0.0, 1.0);
    if (view_of(i) == PLACE) {
        bool there = l.components > 2 ? v.z > 0.0 : v.xy != vec2(0.0);
        vec2 texel_center = (floor(layer_uv * size_of(i)) + 0.5) / size_of(i);
        return vec4(v.xy - (texel_center * l.own.xy + l.own.zw), 0.0, there ? 1.0 : 0.0);
    }
    if (view_of(i) == WORLD) {
        ivec2 texels = textureSize(rendered_depth, 0).xy, at = texel_at(layer_uv, texels);
        float z = texelFetch(rendered_depth, ivec3(at, 0), 0).r;
        bool there = has_depth && has_source && v.w != 0.0 && !is_bad(z);
        return vec4(v.xyz - unproject(vec2(at) + 0.5, z, source_inverse), there ? 1.0 : 0.0);
    }
    return vec4(v[max(channel_of(i), 0)], 0.0, 0.0, 1.0);
}

vec3 show_color(const int i, vec4 c) {
    Layer l = layer[i];
    if (is_weighted(i)) {
        if (c.a == 0.0) return hatch();
        c.rgb /= c.a;
    }
    if (channel_of(i) >= 0) c.rgb = vec3(c[max(channel_of(i), 0)]);
    if (is_bad(c.rgb)) return checker();
    return tone_mapped(c.rgb * l.gain, tone_map_of(i));
}

/* What layer i looks like at `uv` of the display. */
vec3 show(const int i, const vec2 uv) {
    if (!covers(i, uv)) return background;
    Layer l = layer[i];
    int view = view_of(i);
    vec2 layer_uv = uv_of(i, uv);
    vec4 texel = load(i, layer_uv);
    if (view == COLOR) return show_color(i, texel);
    vec4 v = vector_of(i, layer_uv, texel);
    if (v.w == 0.0) return hatch();
    if (view == LABEL) return label_colors[(int(v.x + 0.5) & 15) ^ l.label_flip];
    if (view == MASK) return v.x != 0.0 ? l.tint : MASK_OFF;
    if (view == DEPTH && is_sky(v.x)) return SKY;
    if (view == DEPTH && v.x <= 0.0) return hatch();
    if (is_bad(v.xyz)) return checker();
    if (view == MOTION || view == PLACE) return wheel(v.xy, l.motion_scale);
    return mapped(ramp_position(view, l, view == WORLD ? length(v.xyz) : v.x), l.color_map);
}

/* Whether layer i holds NaN or infinity there; depth may be infinite. */
bool holds_bad(const int i, const vec2 uv) {
    vec4 texel = load(i, uv_of(i, uv));
    if (view_of(i) == COLOR) return is_bad(texel.rgb) && !(is_weighted(i) && texel.a == 0.0);
    if (view_of(i) == LABEL || view_of(i) == MASK) return false;
    vec4 v = vector_of(i, uv_of(i, uv), texel);
    return v.w != 0.0 && is_bad(v.xyz) && !(view_of(i) == DEPTH && is_sky(v.x));
}

float mean_of(const vec3 c) { return (c.x + c.y + c.z) / 3.0; }

vec3 diverging(const float difference_of) {
    return mapped(0.5 + 0.5 * difference_of / difference_high, MAP_DIVERGING);
}

/* A share of the larger of both values; all of it where they are infinite. */
vec3 relative(const float size, const float whole) {
    float share = size == 0.0 ? 0.0 : is_bad(size) || is_bad(whole) ? 1.0 : size / whole;
    return mapped(share / difference_high, MAP_HEAT);
}

/* A - B of displayed colors, where one is color or they differ in kind; each channel by itself if absolute. */
vec3 color_difference(const vec2 uv) {
    vec3 a = show(0, uv), b = show(1, uv), d = a - b;
    if (difference == SIGNED) return diverging(mean_of(d));
    if (difference == RELATIVE) return relative(mean_of(abs(d)), max(mean_of(a), mean_of(b)));
    if (difference == MEAN) return mapped(mean_of(abs(d)) / difference_high, MAP_HEAT);
    return abs(d) / difference_high;
}

/* A - B of values: of vectors their length, or with SIGNED their direction. */
vec3 show_difference(const vec2 uv) {
    if (!covers(0, uv) || !covers(1, uv)) return background;
    if (holds_bad(0, uv) || holds_bad(1, uv)) return checker();
    if (VIEW_A == COLOR || VIEW_A != VIEW_B) return color_difference(uv);
    vec4 a = vector_of(0, uv_of(0, uv), load(0, uv_of(0, uv))), b = vector_of(1, uv_of(1, uv), load(1, uv_of(1, uv)));
    if (a.w == 0.0 || b.w == 0.0) return hatch();
    if (VIEW_A == LABEL || VIEW_A == MASK) return mapped(a == b ? 0.0 : 1.0, MAP_HEAT);
    vec3 d = a == b ? vec3(0.0) : a.xyz - b.xyz;  /* 0 between infinite depths */
    if (difference == SIGNED && (VIEW_A == MOTION || VIEW_A == PLACE)) return wheel(d.xy, difference_high);
    if (difference == SIGNED && VIEW_A != WORLD) return diverging(clamp(d.x, -1e18, 1e18));
    float size = length(d);
    if (difference == RELATIVE) return relative(size, max(length(a.xyz), length(b.xyz)));
    return mapped(min(size, 1e18) / difference_high, MAP_HEAT);
}

vec3 overlaid(const vec3 picture, const vec2 uv) {
    if (OVERLAY != CLIPPING || VIEW_A != COLOR || !covers(0, uv)) return picture;
    vec3 c = load(0, uv_of(0, uv)).rgb * layer[0].gain;
    if (min(c.r, min(c.g, c.b)) < 0.0) return NEGATIVE;
    return max(c.r, max(c.g, c.b)) > 1.0 ? CLIPPED : picture;
}

vec3 with_grid(const vec3 c, const vec2 uv) {
    if (GRID == 0 || !covers(0, uv)) return c;
    vec2 from_line = fract(uv_of(0, uv) * size_of(0)) * layer[0].texel;
    if (min(from_line.x, from_line.y) >= 1.0) return c;
    float contrast = dot(c, vec3(0.2126, 0.7152, 0.0722)) > 0.45 ? 0.0 : 1.0;
    return mix(c, vec3(contrast), grid_contrast);
}

void main() {
    vec2 frag = gl_FragCoord.xy - corner;
    if (bottom_up) frag.y = size.y - frag.y;
    vec2 uv = center + (frag - 0.5 * size) * step;
    vec3 c = overlaid(COMPARE == DIFFERENCE ? show_difference(uv) : show(0, uv), uv);
    pixel = vec4(with_grid(c, uv), 1.0);
}
