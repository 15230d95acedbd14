#include "vulkan.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "scene_frag.h"
#include "scene_vert.h"

namespace {

constexpr int BOXES = 7;
constexpr double NEAR = 0.1, FAR = 100;
constexpr VkFormat FORMATS[4] = {VK_FORMAT_R16G16B16A16_SFLOAT, VK_FORMAT_R32_SFLOAT, VK_FORMAT_R32G32_SFLOAT,
                                 VK_FORMAT_D32_SFLOAT};
constexpr VkDeviceSize BYTES[3] = {8, 4, 8};
constexpr VkBufferUsageFlags USAGE = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;

using Matrix = std::array<std::array<double, 4>, 4>;  // [row][column], for column vectors

void check(VkResult result, const char *call) {
    if (result != VK_SUCCESS) throw std::runtime_error(std::string(call) + ": VkResult " + std::to_string(result));
}

Matrix product(const Matrix &a, const Matrix &b) {
    Matrix made{};
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
            for (int k = 0; k < 4; ++k) made[i][j] += a[i][k] * b[k][j];
    return made;
}

// Vulkan's clip space of a camera: its axes are those of gffe's view, x right, y down, z forward.
Matrix clip_from_world(const gffe_camera &camera, double width, double height) {
    Matrix view{}, projection{};
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) view[i][j] = camera.world_to_view[i][j];
    projection[0] = {2 * camera.fx / width, 0, 2 * camera.cx / width - 1, 0};
    projection[1] = {0, 2 * camera.fy / height, 2 * camera.cy / height - 1, 0};
    projection[2] = {0, 0, FAR / (FAR - NEAR), -FAR * NEAR / (FAR - NEAR)};
    projection[3] = {0, 0, 1, 0};
    return product(projection, view);
}

// A floor, and boxes that turn and travel.
Matrix world_from_model(int number, double now) {
    if (number == 0) return {{{12, 0, 0, 0}, {0, 0.1, 0, 0}, {0, 0, 12, 0}, {0, 0, 0, 1}}};
    const int k = number - 1;
    const double angle = now * (1 + 0.2 * k), c = 0.6 * std::cos(angle), s = 0.6 * std::sin(angle);
    return {{{c, 0, s, 4 * std::sin(k + 0.5 * now)}, {0, 1, 0, 1.2}, {-s, 0, c, 1.9 * k - 7}, {0, 0, 0, 1}}};
}

void put(const Matrix &matrix, float *columns) {
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) columns[4 * j + i] = static_cast<float>(matrix[i][j]);
}

VkBufferMemoryBarrier barrier(const Buffer &buffer, VkAccessFlags from, VkAccessFlags to) {
    VkBufferMemoryBarrier made{VK_STRUCTURE_TYPE_BUFFER_MEMORY_BARRIER};
    made.srcAccessMask = from;
    made.dstAccessMask = to;
    made.srcQueueFamilyIndex = made.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    made.buffer = buffer.buffer;
    made.size = VK_WHOLE_SIZE;
    return made;
}

}  // namespace

Renderer::Renderer(uint32_t width, uint32_t height, const uint8_t *uuid) : width_(width), height_(height) {
    open(uuid);
    make_pass();
    make_pipeline();
    readback_ = make_buffer(BYTES[0] * width * height, false);
}

void Renderer::open(const uint8_t *uuid) {
    VkApplicationInfo about{VK_STRUCTURE_TYPE_APPLICATION_INFO};
    about.apiVersion = VK_API_VERSION_1_1;
    VkInstanceCreateInfo info{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
    info.pApplicationInfo = &about;
    check(vkCreateInstance(&info, nullptr, &instance_), "vkCreateInstance");
    uint32_t count = 0;
    vkEnumeratePhysicalDevices(instance_, &count, nullptr);
    std::vector<VkPhysicalDevice> found(count);
    vkEnumeratePhysicalDevices(instance_, &count, found.data());
    bool is_opencls = false;
    for (VkPhysicalDevice one : found) {
        VkPhysicalDeviceIDProperties id{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES};
        VkPhysicalDeviceProperties2 told{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
        told.pNext = &id;
        vkGetPhysicalDeviceProperties2(one, &told);
        const bool fits = uuid && !std::memcmp(uuid, id.deviceUUID, VK_UUID_SIZE);
        if (physical_ && !fits) continue;
        physical_ = one;
        name_ = told.properties.deviceName;
        is_opencls = fits;
        if (fits) break;
    }
    if (!physical_) throw std::runtime_error("there is no Vulkan device");

    uint32_t families = 0;
    vkGetPhysicalDeviceQueueFamilyProperties(physical_, &families, nullptr);
    std::vector<VkQueueFamilyProperties> queues(families);
    vkGetPhysicalDeviceQueueFamilyProperties(physical_, &families, queues.data());
    while (family_ < families && !(queues[family_].queueFlags & VK_QUEUE_GRAPHICS_BIT)) ++family_;
    if (family_ == families) throw std::runtime_error(name_ + ": no queue for graphics");

    const char *const wanted[2] = {"VK_KHR_external_memory_fd", "VK_KHR_external_semaphore_fd"};
    uint32_t extensions = 0;
    vkEnumerateDeviceExtensionProperties(physical_, nullptr, &extensions, nullptr);
    std::vector<VkExtensionProperties> offered(extensions);
    vkEnumerateDeviceExtensionProperties(physical_, nullptr, &extensions, offered.data());
    for (const auto &one : offered) {
        can_share_ |= is_opencls && !std::strcmp(one.extensionName, wanted[0]);
        can_signal_ |= is_opencls && !std::strcmp(one.extensionName, wanted[1]);
    }
#ifdef _WIN32
    can_share_ = false;  // handles of Windows are imported otherwise
#endif
    can_signal_ = can_signal_ && can_share_;
    const float priority = 1;
    VkDeviceQueueCreateInfo queue{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queue.queueFamilyIndex = family_;
    queue.queueCount = 1;
    queue.pQueuePriorities = &priority;
    VkDeviceCreateInfo device{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
    device.queueCreateInfoCount = 1;
    device.pQueueCreateInfos = &queue;
    device.enabledExtensionCount = can_share_ + can_signal_;
    device.ppEnabledExtensionNames = wanted;
    check(vkCreateDevice(physical_, &device, nullptr, &device_), "vkCreateDevice");
    vkGetDeviceQueue(device_, family_, 0, &queue_);

    VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
    pool.queueFamilyIndex = family_;
    check(vkCreateCommandPool(device_, &pool, nullptr, &pool_), "vkCreateCommandPool");
    VkCommandBufferAllocateInfo commands{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
    commands.commandPool = pool_;
    commands.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    commands.commandBufferCount = 1;
    const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, 0};
    for (Work *work : {&rendering_, &showing_}) {
        check(vkAllocateCommandBuffers(device_, &commands, &work->commands), "vkAllocateCommandBuffers");
        check(vkCreateFence(device_, &fence, nullptr, &work->fence), "vkCreateFence");
    }
}

std::array<int, 2> Renderer::make_semaphores() {
    std::array<int, 2> made{-1, -1};
#ifndef _WIN32
    if (!can_signal_) return made;
    const VkExternalSemaphoreHandleTypeFlagBits kind = VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT;
    const auto descriptor =
        reinterpret_cast<PFN_vkGetSemaphoreFdKHR>(vkGetDeviceProcAddr(device_, "vkGetSemaphoreFdKHR"));
    const VkExportSemaphoreCreateInfo exported{VK_STRUCTURE_TYPE_EXPORT_SEMAPHORE_CREATE_INFO, nullptr, kind};
    const VkSemaphoreCreateInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO, &exported, 0};
    for (int k = 0; k < 2; ++k) {
        VkSemaphore &one = k ? shown_ : rendered_;
        check(vkCreateSemaphore(device_, &info, nullptr, &one), "vkCreateSemaphore");
        const VkSemaphoreGetFdInfoKHR get{VK_STRUCTURE_TYPE_SEMAPHORE_GET_FD_INFO_KHR, nullptr, one, kind};
        check(descriptor(device_, &get, &made[k]), "vkGetSemaphoreFdKHR");
    }
#endif
    return made;
}

// ---- memory --------------------------------------------------------------------------------------------

VkDeviceMemory Renderer::allocate(const VkMemoryRequirements &needs, VkMemoryPropertyFlags wanted, const void *more) {
    VkPhysicalDeviceMemoryProperties there;
    vkGetPhysicalDeviceMemoryProperties(physical_, &there);
    VkMemoryAllocateInfo info{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
    info.pNext = more;
    info.allocationSize = needs.size;
    uint32_t &k = info.memoryTypeIndex;
    while (k < there.memoryTypeCount
           && (!(needs.memoryTypeBits >> k & 1) || (there.memoryTypes[k].propertyFlags & wanted) != wanted))
        ++k;
    if (k == there.memoryTypeCount) throw std::runtime_error(name_ + ": no memory of the type that is needed");
    VkDeviceMemory memory;
    check(vkAllocateMemory(device_, &info, nullptr, &memory), "vkAllocateMemory");
    return memory;
}

Buffer Renderer::make_buffer(VkDeviceSize size, bool is_shared) {
    const VkExternalMemoryHandleTypeFlagBits kind = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT;
    Buffer made;
    made.size = size;
    made.is_shared = is_shared;
    VkExternalMemoryBufferCreateInfo external{VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_BUFFER_CREATE_INFO, nullptr, kind};
    VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    info.pNext = is_shared ? &external : nullptr;
    info.size = size;
    info.usage = USAGE;
    check(vkCreateBuffer(device_, &info, nullptr, &made.buffer), "vkCreateBuffer");
    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(device_, made.buffer, &needs);
    made.allocated = needs.size;
    // OpenCL's memory begins at the first byte, so each buffer has a memory of its own.
    VkMemoryDedicatedAllocateInfo own{VK_STRUCTURE_TYPE_MEMORY_DEDICATED_ALLOCATE_INFO};
    own.buffer = made.buffer;
    VkExportMemoryAllocateInfo exported{VK_STRUCTURE_TYPE_EXPORT_MEMORY_ALLOCATE_INFO, &own, kind};
    VkMemoryPropertyFlags wanted = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
    if (!is_shared) wanted = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    made.memory = allocate(needs, wanted, is_shared ? &exported : nullptr);
    check(vkBindBufferMemory(device_, made.buffer, made.memory, 0), "vkBindBufferMemory");
    if (!is_shared) {
        check(vkMapMemory(device_, made.memory, 0, VK_WHOLE_SIZE, 0, &made.mapped), "vkMapMemory");
        return made;
    }
#ifndef _WIN32
    const auto descriptor = reinterpret_cast<PFN_vkGetMemoryFdKHR>(vkGetDeviceProcAddr(device_, "vkGetMemoryFdKHR"));
    VkMemoryGetFdInfoKHR get{VK_STRUCTURE_TYPE_MEMORY_GET_FD_INFO_KHR, nullptr, made.memory, kind};
    check(descriptor(device_, &get, &made.descriptor), "vkGetMemoryFdKHR");
#endif
    return made;
}

Planes Renderer::make_planes(bool are_shared) {
    Planes made;
    for (int k = 0; k < 3; ++k) made[k] = make_buffer(BYTES[k] * width_ * height_, are_shared);
    return made;
}

void Renderer::destroy(Buffer &buffer) {
    vkDestroyBuffer(device_, buffer.buffer, nullptr);
    vkFreeMemory(device_, buffer.memory, nullptr);
    buffer = Buffer();
}

Renderer::Image Renderer::make_image(VkFormat format, VkImageUsageFlags usage) {
    Image made{};
    VkImageCreateInfo info{VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO};
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = format;
    info.extent = {width_, height_, 1};
    info.mipLevels = info.arrayLayers = 1;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.usage = usage;
    check(vkCreateImage(device_, &info, nullptr, &made.image), "vkCreateImage");
    VkMemoryRequirements needs;
    vkGetImageMemoryRequirements(device_, made.image, &needs);
    made.memory = allocate(needs, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, nullptr);
    check(vkBindImageMemory(device_, made.image, made.memory, 0), "vkBindImageMemory");
    VkImageViewCreateInfo view{VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO};
    view.image = made.image;
    view.viewType = VK_IMAGE_VIEW_TYPE_2D;
    view.format = format;
    const bool is_depth = format == VK_FORMAT_D32_SFLOAT;
    view.subresourceRange.aspectMask = static_cast<VkImageAspectFlags>(is_depth ? VK_IMAGE_ASPECT_DEPTH_BIT
 : VK_IMAGE_ASPECT_COLOR_BIT);
    view.subresourceRange.levelCount = view.subresourceRange.layerCount = 1;
    check(vkCreateImageView(device_, &view, nullptr, &made.view), "vkCreateImageView");
    return made;
}

// ---- drawing -------------------------------------------------------------------------------------------

void Renderer::make_pass() {
    VkAttachmentDescription attachments[4]{};
    VkAttachmentReference references[4];
    std::vector<VkImageView> views;
    for (uint32_t k = 0; k < 4; ++k) {
        const bool is_color = k < 3;
        images_.push_back(
            make_image(FORMATS[k], is_color ? VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT
                                            : VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT));
        views.push_back(images_.back().view);
        attachments[k].format = FORMATS[k];
        attachments[k].samples = VK_SAMPLE_COUNT_1_BIT;
        attachments[k].loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR;
        attachments[k].storeOp = is_color ? VK_ATTACHMENT_STORE_OP_STORE : VK_ATTACHMENT_STORE_OP_DONT_CARE;
        attachments[k].stencilLoadOp = VK_ATTACHMENT_LOAD_OP_DONT_CARE;
        attachments[k].stencilStoreOp = VK_ATTACHMENT_STORE_OP_DONT_CARE;
        attachments[k].finalLayout =
            is_color ? VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL : VK_IMAGE_LAYOUT_DEPTH_STENCIL_ATTACHMENT_OPTIMAL;
        references[k] = {k, is_color ? VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL
                                     : VK_IMAGE_LAYOUT_DEPTH_STENCIL_ATTACHMENT_OPTIMAL};
    }
    VkSubpassDescription subpass{};
    subpass.pipelineBindPoint = VK_PIPELINE_BIND_POINT_GRAPHICS;
    subpass.colorAttachmentCount = 3;
    subpass.pColorAttachments = references;
    subpass.pDepthStencilAttachment = &references[3];
    VkSubpassDependency copied{};  // the copies after the pass read what it wrote
    copied.srcSubpass = 0;
    copied.dstSubpass = VK_SUBPASS_EXTERNAL;
    copied.srcStageMask = VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT;
    copied.dstStageMask = VK_PIPELINE_STAGE_TRANSFER_BIT;
    copied.srcAccessMask = VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT;
    copied.dstAccessMask = VK_ACCESS_TRANSFER_READ_BIT;
    VkRenderPassCreateInfo info{VK_STRUCTURE_TYPE_RENDER_PASS_CREATE_INFO};
    info.attachmentCount = 4;
    info.pAttachments = attachments;
    info.subpassCount = 1;
    info.pSubpasses = &subpass;
    info.dependencyCount = 1;
    info.pDependencies = &copied;
    check(vkCreateRenderPass(device_, &info, nullptr, &pass_), "vkCreateRenderPass");
    VkFramebufferCreateInfo target{VK_STRUCTURE_TYPE_FRAMEBUFFER_CREATE_INFO};
    target.renderPass = pass_;
    target.attachmentCount = 4;
    target.pAttachments = views.data();
    target.width = width_;
    target.height = height_;
    target.layers = 1;
    check(vkCreateFramebuffer(device_, &target, nullptr, &target_), "vkCreateFramebuffer");
}

void Renderer::make_pipeline() {
    const VkPushConstantRange matrices{VK_SHADER_STAGE_VERTEX_BIT, 0, 2 * 16 * sizeof(float)};
    VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
    layout.pushConstantRangeCount = 1;
    layout.pPushConstantRanges = &matrices;
    check(vkCreatePipelineLayout(device_, &layout, nullptr, &layout_), "vkCreatePipelineLayout");

    const float size[2] = {static_cast<float>(width_), static_cast<float>(height_)};
    const VkSpecializationMapEntry entries[2] = {{0, 0, sizeof(float)}, {1, sizeof(float), sizeof(float)}};
    const VkSpecializationInfo constants{2, entries, sizeof size, size};
    VkShaderModuleCreateInfo codes[2]{};
    codes[0] = {VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, nullptr, 0, sizeof scene_vert, scene_vert};
    codes[1] = {VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, nullptr, 0, sizeof scene_frag, scene_frag};
    VkPipelineShaderStageCreateInfo stages[2]{};
    for (int k = 0; k < 2; ++k) {
        stages[k].sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
        stages[k].stage = k ? VK_SHADER_STAGE_FRAGMENT_BIT : VK_SHADER_STAGE_VERTEX_BIT;
        stages[k].pName = "main";
        stages[k].pSpecializationInfo = k ? &constants : nullptr;
        check(vkCreateShaderModule(device_, &codes[k], nullptr, &stages[k].module), "vkCreateShaderModule");
    }
    const VkPipelineVertexInputStateCreateInfo vertices{VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO};
    VkPipelineInputAssemblyStateCreateInfo assembly{VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO};
    assembly.topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST;
    const VkViewport viewport{0, 0, size[0], size[1], 0, 1};
    const VkRect2D scissor{{0, 0}, {width_, height_}};
    VkPipelineViewportStateCreateInfo view{VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO};
    view.viewportCount = view.scissorCount = 1;
    view.pViewports = &viewport;
    view.pScissors = &scissor;
    VkPipelineRasterizationStateCreateInfo raster{VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO};
    raster.cullMode = VK_CULL_MODE_NONE;
    raster.lineWidth = 1;
    VkPipelineMultisampleStateCreateInfo samples{VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO};
    samples.rasterizationSamples = VK_SAMPLE_COUNT_1_BIT;
    VkPipelineDepthStencilStateCreateInfo depth{VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO};
    depth.depthTestEnable = depth.depthWriteEnable = VK_TRUE;
    depth.depthCompareOp = VK_COMPARE_OP_LESS;
    VkPipelineColorBlendAttachmentState written[3]{};
    for (auto &one : written) one.colorWriteMask = 15;
    VkPipelineColorBlendStateCreateInfo blending{VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO};
    blending.attachmentCount = 3;
    blending.pAttachments = written;
    VkGraphicsPipelineCreateInfo info{VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO};
    info.stageCount = 2;
    info.pStages = stages;
    info.pVertexInputState = &vertices;
    info.pInputAssemblyState = &assembly;
    info.pViewportState = &view;
    info.pRasterizationState = &raster;
    info.pMultisampleState = &samples;
    info.pDepthStencilState = &depth;
    info.pColorBlendState = &blending;
    info.layout = layout_;
    info.renderPass = pass_;
    check(vkCreateGraphicsPipelines(device_, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline_),
          "vkCreateGraphicsPipelines");
    for (auto &one : stages) vkDestroyShaderModule(device_, one.module, nullptr);
}

gffe_camera Renderer::camera(double now) const {
    const double x = 9 * std::cos(0.4 * now), y = 4, z = 9 * std::sin(0.4 * now), across = std::hypot(x, z);
    const double far = std::hypot(across, y - 1);  // it looks at (0, 1, 0); the world's y is up
    const double forward[3] = {-x / far, (1 - y) / far, -z / far}, right[3] = {z / across, 0, -x / across};
    const double down[3] = {forward[1] * right[2] - forward[2] * right[1],
                            forward[2] * right[0] - forward[0] * right[2],
                            forward[0] * right[1] - forward[1] * right[0]};
    gffe_camera made{};
    const double *axes[3] = {right, down, forward};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) made.world_to_view[i][j] = axes[i][j];
        made.world_to_view[i][3] = -(axes[i][0] * x + axes[i][1] * y + axes[i][2] * z);
    }
    made.world_to_view[3][3] = 1;
    made.fx = made.fy = 0.9 * width_;
    made.cx = width_ / 2.0;
    made.cy = height_ / 2.0;
    return made;
}

void Renderer::begin(Work &work) {
    if (work.is_begun) wait(work);  // long done: `show` has waited for what came after it
    VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    check(vkBeginCommandBuffer(work.commands, &info), "vkBeginCommandBuffer");
}

void Renderer::submit(Work &work, VkSemaphore waited, VkSemaphore signaled) {
    check(vkEndCommandBuffer(work.commands), "vkEndCommandBuffer");
    const VkPipelineStageFlags stage = VK_PIPELINE_STAGE_ALL_COMMANDS_BIT;
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.waitSemaphoreCount = waited != VK_NULL_HANDLE;
    info.pWaitSemaphores = &waited;
    info.pWaitDstStageMask = &stage;
    info.commandBufferCount = 1;
    info.pCommandBuffers = &work.commands;
    info.signalSemaphoreCount = signaled != VK_NULL_HANDLE;
    info.pSignalSemaphores = &signaled;
    check(vkQueueSubmit(queue_, 1, &info, work.fence), "vkQueueSubmit");
    work.is_begun = true;
}

void Renderer::wait(Work &work) {
    check(vkWaitForFences(device_, 1, &work.fence, VK_TRUE, UINT64_MAX), "vkWaitForFences");
    check(vkResetFences(device_, 1, &work.fence), "vkResetFences");
    work.is_begun = false;
}

void Renderer::render(double now, double before, Planes &planes) {
    begin(rendering_);
    const VkCommandBuffer commands = rendering_.commands;
    VkClearValue clear[4]{};
    clear[0].color = {{0.1f, 0.2f, 0.4f, 1}};
    clear[1].color.float32[0] = std::numeric_limits<float>::infinity();  // depth of the sky
    clear[3].depthStencil.depth = 1;
    VkRenderPassBeginInfo pass{VK_STRUCTURE_TYPE_RENDER_PASS_BEGIN_INFO};
    pass.renderPass = pass_;
    pass.framebuffer = target_;
    pass.renderArea.extent = {width_, height_};
    pass.clearValueCount = 4;
    pass.pClearValues = clear;
    vkCmdBeginRenderPass(commands, &pass, VK_SUBPASS_CONTENTS_INLINE);
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline_);
    const Matrix clip = clip_from_world(camera(now), width_, height_);
    const Matrix old_clip = clip_from_world(camera(before), width_, height_);
    for (int number = 0; number <= BOXES; ++number) {
        float matrices[32];
        put(product(clip, world_from_model(number, now)), matrices);
        put(product(old_clip, world_from_model(number, before)), matrices + 16);
        vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_VERTEX_BIT, 0, sizeof matrices, matrices);
        vkCmdDraw(commands, 36, 1, 0, static_cast<uint32_t>(number));
    }
    vkCmdEndRenderPass(commands);

    std::vector<VkBufferMemoryBarrier> given, taken;
    VkBufferImageCopy region{};
    region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    region.imageExtent = {width_, height_, 1};
    for (const Buffer &one : planes) {
        taken.push_back(barrier(one, 0, VK_ACCESS_TRANSFER_WRITE_BIT));
        given.push_back(barrier(one, VK_ACCESS_TRANSFER_WRITE_BIT, one.is_shared ? 0 : VK_ACCESS_HOST_READ_BIT));
        if (!one.is_shared) continue;
        taken.back().srcQueueFamilyIndex = given.back().dstQueueFamilyIndex = VK_QUEUE_FAMILY_EXTERNAL;
        taken.back().dstQueueFamilyIndex = given.back().srcQueueFamilyIndex = family_;
    }
    vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, nullptr, 3,
                         taken.data(), 0, nullptr);
    for (int k = 0; k < 3; ++k)
        vkCmdCopyImageToBuffer(commands, images_[k].image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, planes[k].buffer, 1,
                               &region);
    vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                         planes[0].is_shared ? VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT : VK_PIPELINE_STAGE_HOST_BIT, 0, 0,
                         nullptr, 3, given.data(), 0, nullptr);
    const VkSemaphore signaled = planes[0].is_shared ? rendered_ : VK_NULL_HANDLE;
    submit(rendering_, VK_NULL_HANDLE, signaled);
    if (signaled) return;
    ++waits_;
    wait(rendering_);
}

std::vector<uint16_t> Renderer::show(const Buffer &color) {
    begin(showing_);
    const VkCommandBuffer commands = showing_.commands;
    VkBufferMemoryBarrier taken =
        barrier(color, color.is_shared ? 0 : VK_ACCESS_HOST_WRITE_BIT, VK_ACCESS_TRANSFER_READ_BIT);
    VkBufferMemoryBarrier given = barrier(color, VK_ACCESS_TRANSFER_READ_BIT, 0);
    if (color.is_shared) {
        taken.srcQueueFamilyIndex = given.dstQueueFamilyIndex = VK_QUEUE_FAMILY_EXTERNAL;
        taken.dstQueueFamilyIndex = given.srcQueueFamilyIndex = family_;
    }
    const VkBufferMemoryBarrier read[2] = {given,
                                           barrier(readback_, VK_ACCESS_TRANSFER_WRITE_BIT, VK_ACCESS_HOST_READ_BIT)};
    vkCmdPipelineBarrier(commands, color.is_shared ? VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT : VK_PIPELINE_STAGE_HOST_BIT,
                         VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, nullptr, 1, &taken, 0, nullptr);
    const VkBufferCopy whole{0, 0, readback_.size};
    vkCmdCopyBuffer(commands, color.buffer, readback_.buffer, 1, &whole);
    vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 0, nullptr, 2, read,
                         0, nullptr);
    submit(showing_, color.is_shared ? shown_ : VK_NULL_HANDLE, VK_NULL_HANDLE);
    ++waits_;
    wait(showing_);  // for the host's copy: a swapchain would present
    const auto *first = static_cast<const uint16_t *>(readback_.mapped);
    return {first, first + readback_.size / sizeof *first};
}

Renderer::~Renderer() {
    if (device_) {
        vkDeviceWaitIdle(device_);
        destroy(readback_);
        vkDestroyPipeline(device_, pipeline_, nullptr);
        vkDestroyPipelineLayout(device_, layout_, nullptr);
        vkDestroyFramebuffer(device_, target_, nullptr);
        vkDestroyRenderPass(device_, pass_, nullptr);
        for (auto &one : images_) {
            vkDestroyImageView(device_, one.view, nullptr);
            vkDestroyImage(device_, one.image, nullptr);
            vkFreeMemory(device_, one.memory, nullptr);
        }
        for (Work *work : {&rendering_, &showing_}) vkDestroyFence(device_, work->fence, nullptr);
        for (VkSemaphore one : {rendered_, shown_}) vkDestroySemaphore(device_, one, nullptr);
        vkDestroyCommandPool(device_, pool_, nullptr);
        vkDestroyDevice(device_, nullptr);
    }
    if (instance_) vkDestroyInstance(instance_, nullptr);
}
