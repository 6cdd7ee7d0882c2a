/* A camera without a kernel: one path is answered by the test's process, in place of a driver of Video4Linux.
 *
 * Loaded with LD_PRELOAD. Opening the path of $FAKE_V4L2 connects to the socket of the same name with ".sock" at its end;
 * the descriptor is that socket, so select and poll work by themselves; it tells the other side when the stream begins. Calls for a descriptor of ours are answered here:
 * modes from a table that the other side sends when it is connected, pictures as it sends them. When the other side hangs
 * up, the camera has been torn out: calls fail with ENODEV, as a driver's do. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#define MOST_MODES 16
#define BUFFERS 4
#define BUFFER_BYTES (4 << 20)
#define MOST_FILES 1024

struct mode {
    uint32_t format, width, height, fps; /* fps 0: it does not say */
};

struct profile { /* the other side's first message */
    int32_t open_errno, format_errno, buffers_errno;
    uint32_t quantization, modes, exposure_is_known, is_range;
    char card[32];
    struct mode mode[MOST_MODES];
};

struct head { /* of a picture; its bytes follow, or nothing where taking it out is to fail */
    uint32_t sequence, flags, size, error;
    uint64_t seconds, micros;
};

struct camera {
    int is_ours, is_streaming;
    struct profile profile;
    struct mode now;
    unsigned char *memory[BUFFERS];
    int queue[BUFFERS], queued; /* buffers that wait to be filled, first one first */
};

static struct camera cameras[MOST_FILES];

static int fail(int number) {
    errno = number;
    return -1;
}

static int connect_to(const char *path) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    snprintf(address.sun_path, sizeof address.sun_path, "%s.sock", path);
    int file = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (file < 0 || file >= MOST_FILES) return fail(EMFILE);
    struct camera *camera = &cameras[file];
    memset(camera, 0, sizeof *camera);
    if (connect(file, (struct sockaddr *)&address, sizeof address) != 0 ||
        recv(file, &camera->profile, sizeof camera->profile, MSG_WAITALL) != sizeof camera->profile) {
        close(file);
        return fail(ENODEV);
    }
    if (camera->profile.open_errno) {
        int number = camera->profile.open_errno;
        close(file);
        return fail(number);
    }
    camera->is_ours = 1;
    camera->now = camera->profile.mode[0];
    return file;
}

static int is_wanted(const char *path) {
    const char *fake = getenv("FAKE_V4L2");
    return fake != NULL && strcmp(path, fake) == 0 && access(path, F_OK) == 0;
}

#define OPENER(name)                                                        \
    int name(const char *path, int flags, ...) {                            \
        static int (*real)(const char *, int, ...);                         \
        if (is_wanted(path)) return connect_to(path);                       \
        if (real == NULL) real = dlsym(RTLD_NEXT, #name);                   \
        va_list rest;                                                       \
        va_start(rest, flags);                                              \
        int mode = va_arg(rest, int);                                       \
        va_end(rest);                                                       \
        return real(path, flags, mode);                                     \
    }
OPENER(open)
OPENER(open64)

static int fill(struct camera *camera, int file, struct v4l2_buffer *buffer) {
    struct head head;
    if (!camera->is_streaming) return fail(EINVAL);
    if (camera->queued == 0) return fail(EAGAIN);
    ssize_t seen = recv(file, &head, sizeof head, MSG_PEEK | MSG_DONTWAIT);
    if (seen < (ssize_t)sizeof head) return fail(seen > 0 || (seen < 0 && errno == EAGAIN) ? EAGAIN : ENODEV);
    recv(file, &head, sizeof head, MSG_WAITALL);
    if (head.error) return fail(head.error);
    int index = camera->queue[0];
    memmove(camera->queue, camera->queue + 1, --camera->queued * sizeof *camera->queue);
    buffer->index = index;
    buffer->bytesused = head.size;
    if (head.size > BUFFER_BYTES || recv(file, camera->memory[index], head.size, MSG_WAITALL) != (ssize_t)head.size)
        return fail(ENODEV);
    buffer->flags = head.flags;
    buffer->sequence = head.sequence;
    buffer->timestamp.tv_sec = head.seconds;
    buffer->timestamp.tv_usec = head.micros;
    buffer->length = BUFFER_BYTES;
    return 0;
}

static int list_formats(struct camera *camera, struct v4l2_fmtdesc *asked) {
    unsigned seen = 0;
    for (unsigned i = 0; i < camera->profile.modes; i++) {
        uint32_t format = camera->profile.mode[i].format;
        int is_known = 0;
        for (unsigned j = 0; j < i; j++) is_known |= camera->profile.mode[j].format == format;
        if (is_known || seen++ != asked->index) continue;
        asked->pixelformat = format;
        memcpy(asked->description, &format, 4);
        return 0;
    }
    return fail(EINVAL);
}

static int list_sizes(struct camera *camera, struct v4l2_frmsizeenum *asked) {
    unsigned seen = 0;
    for (unsigned i = 0; i < camera->profile.modes; i++) {
        struct mode *mode = &camera->profile.mode[i];
        if (mode->format != asked->pixel_format || seen++ != asked->index) continue;
        if (camera->profile.is_range) {
            asked->type = V4L2_FRMSIZE_TYPE_STEPWISE;
            asked->stepwise = (struct v4l2_frmsize_stepwise){16, mode->width, 2, 16, mode->height, 2};
            return 0;
        }
        asked->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        asked->discrete.width = mode->width;
        asked->discrete.height = mode->height;
        return 0;
    }
    return fail(EINVAL);
}

static int list_rates(struct camera *camera, struct v4l2_frmivalenum *asked) {
    for (unsigned i = 0; asked->index == 0 && i < camera->profile.modes; i++) {
        struct mode *mode = &camera->profile.mode[i];
        if (mode->format != asked->pixel_format || mode->fps == 0) continue;
        if (camera->profile.is_range) {
            asked->type = V4L2_FRMIVAL_TYPE_CONTINUOUS;
            asked->stepwise = (struct v4l2_frmival_stepwise){{1, mode->fps}, {1, 1}, {1, 1}};
            return 0;
        }
        if (mode->width != asked->width || mode->height != asked->height) continue;
        asked->type = V4L2_FRMIVAL_TYPE_DISCRETE;
        asked->discrete.numerator = 1;
        asked->discrete.denominator = mode->fps;
        return 0;
    }
    return fail(EINVAL);
}

static void tell_format(struct camera *camera, struct v4l2_format *asked) {
    asked->fmt.pix.width = camera->now.width;
    asked->fmt.pix.height = camera->now.height;
    asked->fmt.pix.pixelformat = camera->now.format;
    asked->fmt.pix.bytesperline = camera->now.format == V4L2_PIX_FMT_YUYV ? 2 * camera->now.width : 0;
    asked->fmt.pix.sizeimage = BUFFER_BYTES;
    asked->fmt.pix.colorspace = V4L2_COLORSPACE_SRGB;
    asked->fmt.pix.quantization = camera->profile.quantization;
}

static int set_format(struct camera *camera, struct v4l2_format *asked) {
    if (camera->profile.format_errno) return fail(camera->profile.format_errno);
    for (unsigned i = 0; i < camera->profile.modes; i++) {
        struct mode *mode = &camera->profile.mode[i];
        if (mode->format != asked->fmt.pix.pixelformat) continue;
        if (camera->profile.is_range)
            camera->now = (struct mode){mode->format, asked->fmt.pix.width, asked->fmt.pix.height, mode->fps};
        else if (mode->width == asked->fmt.pix.width && mode->height == asked->fmt.pix.height)
            camera->now = *mode; /* a driver takes the nearest; here that is the one before */
    }
    tell_format(camera, asked);
    return 0;
}

static int request(struct camera *camera, struct v4l2_requestbuffers *asked) {
    if (asked->count && camera->profile.buffers_errno) return fail(camera->profile.buffers_errno);
    asked->count = asked->count > BUFFERS ? BUFFERS : asked->count;
    for (unsigned i = 0; i < asked->count && camera->memory[i] == NULL; i++)
        camera->memory[i] = mmap(NULL, BUFFER_BYTES, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    camera->queued = 0;
    return 0;
}

static int control(struct camera *camera, struct v4l2_control *asked) {
    if (!camera->profile.exposure_is_known) return fail(EINVAL);
    asked->value = asked->id == V4L2_CID_EXPOSURE_AUTO ? V4L2_EXPOSURE_MANUAL : 100; /* 10 ms */
    return 0;
}

static int answer(struct camera *camera, int file, unsigned long what, void *value) {
    char byte;
    if (what != VIDIOC_DQBUF && recv(file, &byte, 1, MSG_PEEK | MSG_DONTWAIT) == 0) return fail(ENODEV);
    switch (what) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *asked = value;
        memcpy(asked->driver, "uvcvideo", 9);
        memcpy(asked->card, camera->profile.card, sizeof asked->card);
        memcpy(asked->bus_info, "usb-fake-1", 11);
        asked->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        asked->capabilities = asked->device_caps | V4L2_CAP_DEVICE_CAPS;
        return 0;
    }
    case VIDIOC_ENUM_FMT: return list_formats(camera, value);
    case VIDIOC_ENUM_FRAMESIZES: return list_sizes(camera, value);
    case VIDIOC_ENUM_FRAMEINTERVALS: return list_rates(camera, value);
    case VIDIOC_S_FMT: return set_format(camera, value);
    case VIDIOC_G_FMT: tell_format(camera, value); return 0;
    case VIDIOC_S_PARM: {
        struct v4l2_streamparm *asked = value;
        struct v4l2_fract *wanted = &asked->parm.capture.timeperframe;
        if (camera->profile.is_range && wanted->numerator)
            camera->now.fps = wanted->denominator / wanted->numerator;
        asked->parm.capture.timeperframe.numerator = 1;
        asked->parm.capture.timeperframe.denominator = camera->now.fps ? camera->now.fps : 30;
        return 0;
    }
    case VIDIOC_REQBUFS: return request(camera, value);
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *asked = value;
        asked->length = BUFFER_BYTES;
        asked->m.offset = asked->index * BUFFER_BYTES;
        return 0;
    }
    case VIDIOC_QBUF: camera->queue[camera->queued++] = ((struct v4l2_buffer *)value)->index; return 0;
    case VIDIOC_DQBUF: return fill(camera, file, value);
    case VIDIOC_STREAMON: camera->is_streaming = 1; return send(file, "S", 1, MSG_NOSIGNAL) == 1 ? 0 : fail(ENODEV);
    case VIDIOC_STREAMOFF: camera->is_streaming = 0; return 0;
    case VIDIOC_G_CTRL: return control(camera, value);
    default: return fail(ENOTTY);
    }
}

int ioctl(int file, unsigned long what, ...) {
    static int (*real)(int, unsigned long, ...);
    va_list rest;
    va_start(rest, what);
    void *value = va_arg(rest, void *);
    va_end(rest);
    if (file >= 0 && file < MOST_FILES && cameras[file].is_ours) {
        struct v4l2_buffer *asked = value; /* the caller's request is an int in Python, and may come sign-extended */
        return answer(&cameras[file], file, what & 0xffffffffUL, asked);
    }
    if (real == NULL) real = dlsym(RTLD_NEXT, "ioctl");
    return real(file, what, value);
}

#define MAPPER(name, offset_type)                                                                   \
    void *name(void *where, size_t length, int protection, int flags, int file, offset_type offset) { \
        static void *(*real)(void *, size_t, int, int, int, offset_type);                           \
        if (file >= 0 && file < MOST_FILES && cameras[file].is_ours)                                \
            return cameras[file].memory[offset / BUFFER_BYTES];                                     \
        if (real == NULL) real = dlsym(RTLD_NEXT, #name);                                           \
        return real(where, length, protection, flags, file, offset);                                \
    }
MAPPER(mmap, off_t)
MAPPER(mmap64, off64_t)

int close(int file) {
    static int (*real)(int);
    if (file >= 0 && file < MOST_FILES) cameras[file].is_ours = 0;
    if (real == NULL) real = dlsym(RTLD_NEXT, "close");
    return real(file);
}
