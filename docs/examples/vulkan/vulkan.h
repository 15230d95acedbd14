// The renderer: color, depth and motion of a small scene, drawn by Vulkan into buffers that OpenCL may share.
#pragma once
#include <vulkan/vulkan.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "gffe.h"

// A buffer. `mapped`: its memory on the host; null where it is the device's. `descriptor`: of memory that OpenCL can
// import, which becomes OpenCL's; -1 for none.
struct Buffer {
    VkBuffer buffer = VK_NULL_HANDLE;
    VkDeviceMemory memory = VK_NULL_HANDLE;
    VkDeviceSize size = 0, allocated = 0;
    void *mapped = nullptr;
    int descriptor = -1;
    bool is_shared = false;
};

using Planes = std::array<Buffer, 3>;  // color: half x 4, depth: float, motion: float x 2

class Renderer {
  public:
    // Opens the Vulkan device with this UUID, or the first one. Throws std::runtime_error, as all members do.
    Renderer(uint32_t width, uint32_t height, const uint8_t *uuid);
    ~Renderer();
    Renderer(const Renderer &) = delete;
    Renderer &operator=(const Renderer &) = delete;

    const std::string &name() const { return name_; }
    bool can_share() const { return can_share_; }
    // Makes semaphores for shared buffers, if the device can export them, and returns their descriptors, which become
    // OpenCL's; else -1. `render` signals the first then, and `show` waits for the second, instead of the host.
    std::array<int, 2> make_semaphores();
    int waits() const { return waits_; }  // so often the host has waited
    Buffer make_buffer(VkDeviceSize size, bool is_shared);
    Planes make_planes(bool are_shared);
    void destroy(Buffer &buffer);

    // Renders the frame of `now` into `planes`; its motion leads to the frame of `before`. The host waits for it unless
    // there are semaphores.
    void render(double now, double before, Planes &planes);
    // Copies a color buffer to the host, as a copy to a swapchain's image would be made, and returns it: half x 4.
    std::vector<uint16_t> show(const Buffer &color);
    // The camera of the scene at a time, for gffe.
    gffe_camera camera(double now) const;

  private:
    struct Image {
        VkImage image;
        VkDeviceMemory memory;
        VkImageView view;
    };
    void open(const uint8_t *uuid);
    void make_pass();
    void make_pipeline();
    Image make_image(VkFormat format, VkImageUsageFlags usage);
    VkDeviceMemory allocate(const VkMemoryRequirements &needs, VkMemoryPropertyFlags wanted, const void *more);
    struct Work {  // commands, and the fence of their end
        VkCommandBuffer commands = VK_NULL_HANDLE;
        VkFence fence = VK_NULL_HANDLE;
        bool is_begun = false;
    };
    void begin(Work &work);
    void submit(Work &work, VkSemaphore waited, VkSemaphore signaled);
    void wait(Work &work);

    uint32_t width_, height_, family_ = 0;
    std::string name_;
    bool can_share_ = false, can_signal_ = false;
    int waits_ = 0;
    VkInstance instance_ = VK_NULL_HANDLE;
    VkPhysicalDevice physical_ = VK_NULL_HANDLE;
    VkDevice device_ = VK_NULL_HANDLE;
    VkQueue queue_ = VK_NULL_HANDLE;
    VkCommandPool pool_ = VK_NULL_HANDLE;
    Work rendering_, showing_;
    VkSemaphore rendered_ = VK_NULL_HANDLE, shown_ = VK_NULL_HANDLE;
    std::vector<Image> images_;
    VkRenderPass pass_ = VK_NULL_HANDLE;
    VkFramebuffer target_ = VK_NULL_HANDLE;
    VkPipelineLayout layout_ = VK_NULL_HANDLE;
    VkPipeline pipeline_ = VK_NULL_HANDLE;
    Buffer readback_;
};
