// A renderer in Vulkan whose frames gffe extrapolates: 30 rendered frames per second, and one made between each two.
// Offscreen; prints how good the made frames are, and writes pictures. docs/interop.md explains it.
//
//     gffe_vulkan OUT [--frames N] [--size WxH] [--platform PART] [--copied | --compare]
//
// --copied: copies even where memory could be shared; --compare: both ways, whose bits must be the same.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <memory>
#include <stdexcept>

#include "opencl.h"
#include "vulkan.h"

namespace {

struct Wanted {
    std::string out, platform;
    int frames = 12, width = 640, height = 360;
    bool is_copied = false, is_compared = false;
};

struct Found {
    std::vector<std::vector<uint16_t>> made;  // half x 4
    double repeated = 0, generated = 0;       // PSNR, dB
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

Found run(const Wanted &wanted, bool is_copied) {
    constexpr double INTERVAL = 1.0 / 30;
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
    Found found;
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

        renderer.render(now, now, truth);  // only to measure
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
        if (word == "--copied")
            wanted.is_copied = true;
        else if (word == "--compare")
            wanted.is_compared = true;
        else if (word == "--platform")
            wanted.platform = value, ++k;
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
            "usage: gffe_vulkan OUT [--frames N] [--size WxH] [--platform PART] [--copied | --compare]");
    return wanted;
}

}  // namespace

int main(int count, char **arguments) {
    try {
        const Wanted wanted = parsed(count, arguments);
        const Found found = run(wanted, wanted.is_copied);
        if (!wanted.is_compared) return 0;
        const bool are_same = run(wanted, true).made == found.made;
        std::printf("%s\n", are_same ? "the same bits both ways" : "other bits when copied");
        return are_same ? 0 : 1;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "gffe_vulkan: %s\n", error.what());
        return 2;
    }
}
