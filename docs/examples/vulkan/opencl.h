// OpenCL's side: the device, and memory of Vulkan's buffers, shared where the driver can, else copied.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "gffe.h"
#include "vulkan.h"

class Generator {
  public:
    // Opens the first device whose platform's name holds `platform`; of several one that shares memory. Throws
    // std::runtime_error, as all members do.
    Generator(const std::string &platform);
    ~Generator();
    Generator(const Generator &) = delete;
    Generator &operator=(const Generator &) = delete;

    const std::string &name() const { return name_; }
    const uint8_t *uuid() const { return can_share_ ? uuid_.data() : nullptr; }  // null: it cannot share memory
    void open(int width, int height);                                            // the pipeline

    // Takes the memory of a buffer of Vulkan, or makes a buffer beside it. It must be closed before Vulkan's.
    cl_mem take(Buffer &buffer);
    // Takes the semaphores of `Renderer::make_semaphores`, if there are any, and returns whether it can: `submit` waits
    // for the first then, and `make` signals the second, instead of the host.
    bool take(const std::array<int, 2> &semaphores);
    bool can_signal() const { return can_signal_; }
    // Submits what Vulkan rendered into `planes`, which `memory` holds; copies it before, where it is not shared.
    void submit(const Planes &planes, const std::array<cl_mem, 3> &memory, const gffe_camera &camera, double time,
                bool reset);
    // Makes the frame of `time` into `shown`, which `memory` holds. The host waits for it unless there are semaphores.
    void make(const gffe_camera &camera, double time, Buffer &shown, cl_mem memory);
    double shared_milliseconds() const { return shared_milliseconds_; }  // spent with acquiring and releasing
    int waits() const { return waits_; }                                 // so often the host has waited

  private:
    using Exchange = cl_int(CL_API_CALL *)(cl_command_queue, cl_uint, const cl_mem *, cl_uint, const cl_event *,
                                           cl_event *);
    using Semaphore = struct _cl_semaphore_khr *;
    using Switch = cl_int(CL_API_CALL *)(cl_command_queue, cl_uint, const Semaphore *, const cl_ulong *, cl_uint,
                                         const cl_event *, cl_event *);
    void check(cl_int error, const char *call) const;
    void check(gffe_status status) const;
    void exchange(Exchange call, const std::vector<cl_mem> &memory, cl_event *done);

    cl_platform_id platform_ = nullptr;
    cl_device_id device_ = nullptr;
    cl_context context_ = nullptr;
    cl_command_queue queue_ = nullptr;
    gffe *gffe_ = nullptr;
    std::string name_;
    std::array<uint8_t, 16> uuid_{};
    bool can_share_ = false, can_signal_ = false;
    Exchange acquire_ = nullptr, release_ = nullptr;
    Switch wait_ = nullptr, signal_ = nullptr;
    Semaphore rendered_ = nullptr, shown_ = nullptr;
    int waits_ = 0;
    std::vector<cl_mem> taken_, in_use_;  // all; those of the last two frames
    double shared_milliseconds_ = 0;
};
