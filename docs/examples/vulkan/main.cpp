// A renderer in Vulkan whose frames gffe extrapolates: 30 rendered frames per second, and one made between each two.
// Offscreen; prints how good the made frames are, and writes pictures. docs/interop.md explains it.
//
//     gffe_vulkan OUT [--frames N] [--size WxH] [--platform PART] [--capture FOLDER] [--compare]
//
// --capture: also writes the rendered frames to FOLDER, for `gffe check FOLDER`, which names wrong motion, depth and
// cameras; --compare: with shared memory and with copies, whose bits must be the same.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <stdexcept>

#include "opencl.h"
#include "vulkan.h"

namespace {

constexpr int RATE = 30;  // rendered frames per second

struct Wanted {
    std::string out, platform, capture;
    int frames = 12, width = 640, height = 360;
    bool is_compared = false;
};

struct Found {
    std::vector<std::vector<uint16_t>> made;  // half x 4
    double repeated = 0, generated = 0;       // PSNR, dB
    bool is_shared = false;
};

double from_half(uint16_t bits) {
    const int exponent = bits >> 10 & 31, mantissa = bits & 1023;
    const double value = exponent ? std::ldexp(mantissa + 1024, exponent - 25) : std::ldexp(mantissa, -24);
    return bits & 0x8000 ? -value : value;
}

// sRGB of linear light, 0 to 1.
double displayed(uint16_t half) {
    const double value = std::fmin(std::fmax(from_half(half), 0), 1);
    return value <= 0.0031308 ? 12.92 * value : 1.055 * std::pow(value, 1 / 2.4) - 0.055;
}

double psnr(const std::vector<uint16_t> &a, const std::vector<uint16_t> &b) {
    double sum = 0;
    for (size_t k = 0; k < a.size(); ++k)
        if (k % 4 < 3) sum += std::pow(displayed(a[k]) - displayed(b[k]), 2);
    return std::fmin(-10 * std::log10(sum / (a.size() / 4 * 3) + 1e-10), 100);
}

void write_picture(const std::string &path, const std::vector<uint16_t> &color, const Wanted &wanted) {
    std::ofstream file(path, std::ios::binary);
    file << "P6\n" << wanted.width << ' ' << wanted.height << "\n255\n";
    for (size_t k = 0; k < color.size(); ++k)
        if (k % 4 < 3) file.put(static_cast<char>(static_cast<int>(displayed(color[k]) * 255 + 0.5)));
    if (!file) throw std::runtime_error(path + ": cannot be written");
}

// ---- a capture: a folder of NPY files that all commands of gffe read (docs/formats.md, "A folder of images") ----

void write_npy(const std::string &path, const Buffer &buffer, const char *type, int channels, const Wanted &wanted) {
    char about[118];  // with the 10 bytes before it 128
    std::snprintf(about, sizeof about, "{'descr': '%s', 'fortran_order': False, 'shape': (%d, %d, %d)}", type,
                  wanted.height, wanted.width, channels);
    std::string header(about);
    header.resize(sizeof about - 1, ' ');
    std::ofstream file(path, std::ios::binary);
    file.write("\x93NUMPY\x01\x00\x76\x00", 10) << header << '\n';
    file.write(static_cast<const char *>(buffer.mapped), static_cast<std::streamsize>(buffer.size));
    if (!file) throw std::runtime_error(path + ": cannot be written");
}

void write_capture(int frame, const Planes &planes, const gffe_camera &camera, const Wanted &wanted) {
    std::filesystem::create_directories(wanted.capture);
    const std::string start = wanted.capture + "/" + std::to_string(frame);
    write_npy(start + "_color.npy", planes[0], "<f2", 4, wanted);
    write_npy(start + "_depth.npy", planes[1], "<f4", 1, wanted);
    write_npy(start + "_motion.npy", planes[2], "<f4", 2, wanted);
    std::ofstream file(start + "_camera.json");
    file.precision(17);
    for (int k = 0; k < 16; ++k) file << (k ? ", " : "{\"view\": [") << camera.world_to_view[k / 4][k % 4];
    file << "], \"fx\": " << camera.fx << ", \"fy\": " << camera.fy << ", \"cx\": " << camera.cx
         << ", \"cy\": " << camera.cy << "}\n";
    std::ofstream(wanted.capture + "/sequence.json")
        << R"({"format": "gffe-folder", "version": 2, "fps": )" << RATE << R"(, "width": )" << wanted.width
        << R"(, "height": )" << wanted.height << R"(, "frames": {"first": 0, "count": )" << frame + 1 << R"(},
 "files": {"color": "%d_color.npy", "depth": "%d_depth.npy", "motion": "%d_motion.npy"},
 "cameras": {"layout": "row-major", "file": "%d_camera.json"}}
)";
}

Found run(const Wanted &wanted, bool is_copied) {
    constexpr double INTERVAL = 1.0 / RATE;
    auto generator = std::make_unique<Generator>(wanted.platform);
    Renderer renderer(static_cast<uint32_t>(wanted.width), static_cast<uint32_t>(wanted.height), generator->uuid());
    const bool is_shared = renderer.can_share() && !is_copied;
    std::printf("Vulkan: %s, OpenCL: %s; buffers are %s\n", renderer.name().c_str(), generator->name().c_str(),
                is_shared ? "shared" : "copied");
    generator->open(wanted.width, wanted.height);

    Planes sets[3], truth = renderer.make_planes(false);  // gffe uses two sets while Vulkan renders into the third
    std::array<cl_mem, 3> memory[3];
    for (int k = 0; k < 3; ++k) {
        sets[k] = renderer.make_planes(is_shared);
        for (int part = 0; part < 3; ++part) memory[k][part] = generator->take(sets[k][part]);
    }
    Buffer shown = renderer.make_buffer(sets[0][0].size, is_shared);
    const cl_mem shown_memory = generator->take(shown);

    const bool are_signaled = is_shared && generator->can_signal() && generator->take(renderer.make_semaphores());
    Found found{{}, 0, 0, is_shared};
    int waits = 0;
    for (int k = 0; k < wanted.frames; ++k) {
        const double now = k * INTERVAL, next = now + INTERVAL / 2;
        Planes &planes = sets[k % 3];
        const int before = renderer.waits() + generator->waits();
        renderer.render(now, now - INTERVAL, planes);
        generator->submit(planes, memory[k % 3], renderer.camera(now), now, k == 0);
        generator->make(renderer.camera(next), next, shown, shown_memory);
        found.made.push_back(renderer.show(shown));
        waits += renderer.waits() + generator->waits() - before;

        renderer.render(now, now - INTERVAL, truth);  // only to measure, and for the capture
        if (!wanted.capture.empty()) write_capture(k, truth, renderer.camera(now), wanted);
        const auto rendered = renderer.show(truth[0]);
        renderer.render(next, next, truth);
        const auto expected = renderer.show(truth[0]);
        if (k < 2) continue;  // movers are unknown in the first frame
        found.repeated += psnr(rendered, expected) / (wanted.frames - 2);
        found.generated += psnr(found.made.back(), expected) / (wanted.frames - 2);
        if (k < wanted.frames - 1) continue;
        write_picture(wanted.out + "/rendered.ppm", rendered, wanted);
        write_picture(wanted.out + "/generated.ppm", found.made.back(), wanted);
        write_picture(wanted.out + "/truth.ppm", expected, wanted);
    }
    std::printf("PSNR: repeated %.2f dB, generated %.2f dB\n", found.repeated, found.generated);
    std::printf("the host waits %d times a frame, %s semaphores\n", waits / wanted.frames,
                are_signaled ? "with" : "without");
    if (is_shared)
        std::printf("acquiring and releasing: %.3f ms of the host a frame\n",
                    generator->shared_milliseconds() / wanted.frames);
    generator.reset();  // before Vulkan's memory is freed
    renderer.destroy(shown);
    for (auto &set : sets)
        for (auto &one : set) renderer.destroy(one);
    for (auto &one : truth) renderer.destroy(one);
    return found;
}

Wanted parsed(int count, char **arguments) {
    Wanted wanted;
    for (int k = 1; k < count; ++k) {
        const std::string word = arguments[k];
        const char *value = k + 1 < count ? arguments[k + 1] : "";
        if (word == "--compare")
            wanted.is_compared = true;
        else if (word == "--platform")
            wanted.platform = value, ++k;
        else if (word == "--capture" && *value)
            wanted.capture = value, ++k;
        else if (word == "--frames" && std::sscanf(value, "%d", &wanted.frames) == 1 && wanted.frames > 2)
            ++k;
        else if (word == "--size" && std::sscanf(value, "%dx%d", &wanted.width, &wanted.height) == 2)
            ++k;
        else if (word[0] != '-' && wanted.out.empty())
            wanted.out = word;
        else
            throw std::runtime_error("unexpected argument '" + word + "' " + value);
    }
    if (wanted.out.empty() || wanted.width < 1 || wanted.height < 1)
        throw std::runtime_error(
            "usage: gffe_vulkan OUT [--frames N] [--size WxH] [--platform PART] [--capture FOLDER] [--compare]");
    return wanted;
}

}  // namespace

int main(int count, char **arguments) {
    try {
        const Wanted wanted = parsed(count, arguments);
        const Found found = run(wanted, false);
        if (!wanted.is_compared) return 0;
        const char *outcome = "nothing was compared: buffers are copied in both ways";
        if (found.is_shared)
            outcome = run(wanted, true).made == found.made ? "the same bits both ways" : "other bits when copied";
        std::printf("%s\n", outcome);
        return outcome == std::string("other bits when copied");
    } catch (const std::exception &error) {
        std::fprintf(stderr, "gffe_vulkan: %s\n", error.what());
        return 2;
    }
}
